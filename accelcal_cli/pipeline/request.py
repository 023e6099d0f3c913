"""What is asked for, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.limits import cpus
from accelcal_cli.core.names import printable
from accelcal_cli.core.settings import DEFAULT, Settings
from accelcal_cli.output.coefficients import Coefficients
from accelcal_cli.pipeline.identity import sha256
from accelcal_cli.pipeline.plan import Job

DEFAULT_CHUNK_SAMPLES = 1 << 18

Progress = Callable[[int], None]
"""Called with the number of bytes of the file that have been read."""

ProgressMaker = Callable[[str, int], Progress]
"""Called with the name of a stage and the bytes to read; makes a Progress."""


def no_progress(_stage: str, _total: int) -> Progress:
    """Shows nothing."""
    return lambda _end_byte: None


class Asked(Protocol):
    """What decides whether an earlier result still holds."""

    @property
    def integers(self) -> bool:
        """Whether the fit's integers are wanted too."""

    @property
    def coefficients_sha256(self) -> str | None:
        """Of the file of known coefficients; None where the recording's own are found."""

    def effective_settings(self, companion: Path | None) -> dict[str, Any]:
        """The report's `settings`."""


@dataclass(frozen=True, slots=True)
class Request:
    """How to calibrate.

    Attributes:
        coefficients: those to apply, None to find the recording's own.
        any_device: apply them whatever device recorded.
        report_only: write no Parquet.
        integers: also write the fit's points and result as integers.
        force: overwrite what accelcal did not write, and redo what is up to date.
        command: the command line, for the provenance.
        threads: how many may work at a time on one recording.
    """

    options: ReadOptions = field(default_factory=ReadOptions)
    settings: Settings = DEFAULT
    chunk_samples: int = DEFAULT_CHUNK_SAMPLES
    report_only: bool = False
    integers: bool = False
    force: bool = False
    command: tuple[str, ...] = ()
    coefficients: Coefficients | None = None
    any_device: bool = False
    threads: int = field(default_factory=cpus)

    @property
    def coefficients_sha256(self) -> str | None:
        """Hash of the file of the coefficients to apply, if there is one."""
        return None if self.coefficients is None else self.coefficients.sha256

    def effective_settings(self, companion: Path | None) -> dict[str, Any]:
        """The report's `settings`: all that decides the result besides the recording.

        Args:
            companion: the file that says how to read the recording; its content counts.
        """
        told = input_settings(self.options, companion)
        return {**self.settings.as_json(), "report_only": self.report_only, "input": told}


def input_settings(options: ReadOptions, companion: Path | None) -> dict[str, Any]:
    """The `input` object of a report's settings: what the user said of the recording."""
    told = asdict(options)
    told["layout"] = None if companion is None else printable(companion.name)
    told["layout_sha256"] = None if companion is None else sha256(companion)
    told["columns"] = None if options.columns is None else list(options.columns)
    return told


@dataclass(frozen=True, slots=True)
class Result:
    """One recording's report, and whether it was up to date already."""

    job: Job
    report: dict[str, Any]
    up_to_date: bool = False

    @property
    def outcome(self) -> Outcome:
        """The report's outcome."""
        return Outcome(self.report["outcome"])

    @property
    def has_parquet(self) -> bool:
        """Whether the calibrated recording was written too."""
        return self.report["calibration"] is not None and not self.report["settings"]["report_only"]

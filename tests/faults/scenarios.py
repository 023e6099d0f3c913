"""The commands that faults are tried on, each with small inputs, and what lies in its folder before it."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.cli.run import exit_code
from tests.recordings import directions, good_raw, still_counts, write_csv, write_raw

MANY = 5
SAMPLES = Path(__file__).resolve().parent.parent.parent / "sample_data"


@dataclass(frozen=True)
class Scenario:
    """A command and its inputs.

    Attributes:
        words: names in them are below the folder in which it runs.
        make: makes the inputs, in `in` and, of earlier results, in `out`.
        code: how it ends undisturbed.
        forks: whether it starts processes, which takes longer.
        again: what a rerun is told besides, over outputs of which some are there.
        parts: whether a part of the recording that the disk does not give costs itself alone.
        most: how many calls of each operation are made to fail at most, where a run takes seconds.
    """

    name: str
    words: tuple[str, ...]
    make: Callable[[Path], object]
    code: int = 0
    forks: bool = False
    again: tuple[str, ...] = ()
    parts: bool = False
    most: int | None = None

    @property
    def command(self) -> str:
        """The first word of its name."""
        return re.split("[ ,]", self.name)[0]


def _recording(folder: Path) -> None:
    good_raw(folder / "in")


def _earlier(folder: Path) -> None:
    """Results of other settings, which are replaced."""
    good_raw(folder / "in")
    _calibrated(folder, "--model", "9", "--prior", "none", "-d", "out", "--html", "--integers")


def _results(folder: Path) -> None:
    """A result beside its recording."""
    good_raw(folder / "in")
    _calibrated(folder, "--windows", "in/windows.parquet")


def _calibrated(folder: Path, *words: str) -> None:
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        assert exit_code("calibrate", "in/good.raw", "-q", *words) == 0


def _archive(folder: Path) -> None:
    """Two tables of half an hour, one after the other."""
    counts, rows = still_counts(directions(60)), 22500
    table = write_csv(folder / "in" / "whole.csv", counts).read_text().splitlines(keepends=True)
    with tarfile.open(folder / "in" / "parts.tar.gz", "w:gz") as archive:
        for number, part in enumerate((table[1 : rows + 1], table[rows + 1 :])):
            path = folder / "in" / f"{number}.csv"
            path.write_text("".join([table[0], *part]))
            archive.add(path, path.name)
            path.unlink()
    (folder / "in" / "whole.csv").unlink()


def _refused(folder: Path) -> None:
    """A recording with too few orientations."""
    write_raw(folder / "in" / "good.raw", still_counts(directions(2)))


def _no_longer_good(folder: Path) -> None:
    """Results of a recording of which too few orientations are left."""
    good_raw(folder / "in")
    _calibrated(folder, "-d", "out", "--html", "--integers")
    _refused(folder)


def _several(folder: Path) -> None:
    """Results of three recordings."""
    _folder(folder)
    paths = sorted(path.relative_to(folder).as_posix() for path in folder.glob("in/*/*.raw"))
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        assert exit_code("calibrate", *paths, "-q", "--report-only", "-d", "in") == 0


def _folder(folder: Path) -> None:
    """Three recordings."""
    for number, poses in enumerate((60, 62, 64)):
        place = folder / "in" / "ab"[number // 2]
        place.mkdir(exist_ok=True)
        write_raw(place / f"p{number}.raw", still_counts(directions(poses), seed=number + 1))


def _six_faces(folder: Path) -> None:
    shutil.copy(SAMPLES / "six_faces.csv.gz", folder / "in" / "six.csv.gz")


def _nothing(_folder: Path) -> None:
    """No inputs."""


def _simulation(form: str) -> Scenario:
    words = ("simulate", "out/sim", "--format", form, "--days", "0.02", "--rate", "50", "-q")
    return Scenario(f"simulate {form}", words, _nothing, again=("--force",))


def _export(form: str, output: str, result: str = "in/good.calibrated.parquet") -> Scenario:
    words = ("export", result, "--to", form, "-o", output, "-q")
    return Scenario(f"export {form}", words, _results, again=("--force",))


CALIBRATE = (
    "calibrate",
    "in/good.raw",
    "-d",
    "out",
    "--html",
    "--integers",
    "--windows",
    "out/w.parquet",
    "-q",
)
REPORT = "in/good.calibration.json"
SEVERAL = tuple(f"in/p{number}.calibration.json" for number in range(3))
SCENARIOS = (
    Scenario("calibrate", CALIBRATE, _recording),
    Scenario("calibrate again", CALIBRATE, _earlier),
    Scenario(
        "calibrate parts", ("calibrate", "in/parts.tar.gz", "-d", "out", "-q"), _archive, parts=True, most=24
    ),
    Scenario(
        "calibrate refused", ("calibrate", "in/good.raw", "-d", "out", "--keep-refused", "-q"), _refused, 4
    ),
    Scenario(
        "calibrate, now refused",
        ("calibrate", "in/good.raw", "-d", "out", "-q", "--html", "--integers"),
        _no_longer_good,
        4,
    ),
    Scenario("apply", ("apply", "in/good.raw", "--coefficients", REPORT, "-d", "out", "-q"), _results),
    Scenario("fit", ("fit", "in/windows.parquet", "-o", "out/fit.json"), _results),
    Scenario("six-pose", ("six-pose", "in/six.csv.gz", "-d", "out", "-q"), _six_faces),
    Scenario("report", ("report", REPORT, "-d", "out", "-q"), _results),
    _export("ggir", "out/ggir.csv", REPORT),
    Scenario(
        "export several",
        ("export", *SEVERAL, "--to", "json", "-o", "out/all.jsonl", "-q"),
        _several,
        again=("--force",),
    ),
    _export("csv", "out/good.csv"),
    _export("npz", "out/good.npz"),
    _export("bids", "out/sub-1_task-rest_tracksys-imu_motion.tsv"),
    *(_simulation(form) for form in ("flash", "csv", "hdf5", "gt3x")),
    Scenario("effect", ("effect", "in/good.raw", "--epochs", "out/epochs.csv", "--csv", "-q"), _recording),
    Scenario("quality", ("quality", "in/good.raw", "-q"), _recording),
    Scenario("inspect", ("inspect", "in/good.raw", "--full"), _recording),
    Scenario("verify", ("verify", REPORT, "in/good.raw", "--values", "-q"), _results),
    Scenario("study", ("study", "in", "-d", "out", "-j", "2", "-q"), _folder, forks=True, most=MANY),
)

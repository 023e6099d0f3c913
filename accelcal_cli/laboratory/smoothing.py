"""`accelcal evaluate smoothing`: the noise filter of Grammenos, Mascolo, Crowcroft 2018 on real stillness.

Their section 4.6, Tables 1 and 2. A rolling mean or median of a few samples makes the noise of single samples
smaller. It is not a part of a calibration: that is fitted to means of whole windows, and stillness is judged
by samples as they are, since a filter that came before it would make movement look still.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, each_recording
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Reader
from accelcal_cli.core.settings import Settings
from accelcal_cli.exports.rows import WIDTHS, width_for
from accelcal_cli.pipeline.jobs import ProgressMaker
from accelcal_cli.pipeline.options import chosen_settings, read_options, recording_options
from accelcal_cli.pipeline.procedures import make_method
from accelcal_cli.pipeline.survey import StillWindows, open_marked, survey

TABLE_1 = {10: (3.4568e-5, 4.6495e-5), 20: (1.8359e-5, 2.6465e-5)}
"""Variances after a rolling mean and median, by number of samples, in a unit that the paper omits."""

MOST_WINDOWS = 1000
"""Largest number of still windows, evenly spread, that are filtered, so that memory is bounded."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Variances:
    """Mean variance of the axes within still windows after filters of one width [g2].

    Attributes:
        width: number of samples of the filter.
    """

    width: int
    mean: float
    median: float


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Noise of a recording at rest, without and with filters.

    Attributes:
        windows: number of still windows that were filtered.
        usual: width for the recording's rate, by Table 2.
        raw: variance without a filter [g2].
    """

    path: Path
    rate_hz: float
    windows: int
    usual: int
    raw: float
    filtered: tuple[Variances, ...]


def smoothing(
    path: Path, options: ReadOptions, settings: Settings, chunk_samples: int, progress: ProgressMaker
) -> Smoothing:
    """Filter the samples of a recording's still windows.

    Raises:
        AccelcalError: it cannot be read.
        UsageError: it has no still window that is long enough.
    """
    with open_marked(path, recording_options(path, options)) as reader:
        recording = reader.recording
        method, still = make_method(recording, settings), StillWindows()
        shown = progress("reading", recording.total_bytes)
        survey(reader.chunks(chunk_samples), method.segmenter, (still,), shown)
        length, first = method.segmenter.length, still.result().first_sample
        if not len(first) or length <= WIDTHS[-1]:
            text = f"has no still window of more than {WIDTHS[-1]} samples"
            raise UsageError(text, path=path, hint="see accelcal inspect, and --segment-seconds")
        chosen = first[np.unique(np.linspace(0, len(first) - 1, MOST_WINDOWS).astype(np.int64))]
        samples = samples_at(reader, chosen, length, chunk_samples) / recording.lsb_per_g
    filtered = tuple(variances(samples, width) for width in WIDTHS)
    return Smoothing(
        path, recording.rate_hz, len(chosen), width_for(recording.rate_hz), _spread(samples), filtered
    )


def samples_at(
    reader: Reader, first: NDArray[np.int64], length: int, chunk_samples: int
) -> NDArray[np.int64]:
    """Return counts (n, length, 3) of n windows, whose first samples have ascending numbers (n,)."""
    samples = np.zeros((len(first), length, 3), np.int64)
    for chunk in reader.chunks(chunk_samples):
        begin, end = chunk.first_sample, chunk.first_sample + len(chunk)
        low, high = np.searchsorted(first, (begin - length + 1, end))
        for place in range(low, high):
            start = int(first[place])
            part = slice(max(start, begin), min(start + length, end))
            rows = chunk.counts[part.start - begin : part.stop - begin]
            samples[place, part.start - start : part.stop - start] = rows
    return samples


def variances(samples: Floats, width: int) -> Variances:
    """Return the variances of (n, length, 3) samples after filters that do not leave their window."""
    means, medians = [], []
    for window in samples:
        views = np.lib.stride_tricks.sliding_window_view(window, width, axis=0)
        means.append(views.mean(axis=-1))
        medians.append(np.median(views, axis=-1))
    return Variances(width, _spread(np.array(means)), _spread(np.array(medians)))


def _spread(samples: Floats) -> float:
    """Return the mean over windows and axes of the variance within a window."""
    return float(samples.var(axis=1, ddof=1).mean())


def as_json(found: Smoothing) -> dict[str, Any]:
    """Return the variances of a recording [g2] as JSON."""
    return {
        "rate_hz": found.rate_hz,
        "windows": found.windows,
        "width_for_rate": found.usual,
        "variance_raw_g2": found.raw,
        "widths": [
            {"samples": one.width, "variance_mean_g2": one.mean, "variance_median_g2": one.median}
            for one in found.filtered
        ],
    }


HEAD = ("samples", "rolling mean", "of raw", "rolling median", "of raw", "")
PUBLISHED = ("Table 1 of Grammenos et al. 2018 (own recording)", "rolling mean", "rolling median")


@click.command(
    "smoothing",
    cls=Command,
    examples=("evaluate smoothing recording.cwa", "evaluate smoothing recording.cwa --json"),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object per line.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.comparing_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show how much smaller a rolling mean or median makes the noise of each RECORDING at rest.

    Variances of samples within still windows [g2], without a filter and with those of Grammenos et al. 2018,
    and which width they have for the recording's rate. Nothing that accelcal calibrates is filtered.
    """

    def work(path: Path, bars: ProgressMaker) -> Smoothing:
        settings, chunk = chosen_settings(values), values["chunk_samples"]
        return smoothing(path, read_options(values), settings, chunk, bars)

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found and values["as_json_"]:
        lines = [json.dumps({"recording": printable(one.path), **as_json(one)}) for one in found]
        exit_codes.show("\n".join(lines))
    elif found:
        rows = [[str(width), f"{mean:.3e}", f"{median:.3e}"] for width, (mean, median) in TABLE_1.items()]
        exit_codes.show("\n\n".join([*map(_text, found), aligned(PUBLISHED, rows)]))
    return code


def _text(one: Smoothing) -> str:
    head = f"{printable(one.path)}: {one.windows} still windows at {one.rate_hz:g} Hz, raw {one.raw:.3e} g2"
    rows = [
        [
            str(made.width),
            *(
                cell
                for value in (made.mean, made.median)
                for cell in (f"{value:.3e}", f"{100 * value / one.raw:.0f} %" if one.raw else "-")
            ),
            "for this rate" if made.width == one.usual else "",
        ]
        for made in one.filtered
    ]
    return f"{head}\n{aligned(HEAD, rows)}"

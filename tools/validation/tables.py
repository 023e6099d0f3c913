"""The comparisons of `make validation`: held-out orientations, hours of wear, two devices, and speed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import accelcal
from bench.peers import peer_commands
from bench.process import Command, timed
from tools.validation.found import RAW, Found, by_posture_mg, everywhere_mg
from tools.validation.methods import Method, peers_python
from tools.validation.samples import Piece, Places, Real, Rests, folds, postures, read, rests

EPOCH_S = 5
MVPA_G = 0.1
RATE_HZ = 25.0
"""Rate of simulated recordings whose accuracy is looked at."""


@dataclass(frozen=True)
class Table:
    """A table of the page, with the sentences before it."""

    name: str
    text: str
    head: tuple[str, ...]
    rows: list[list[str]]

    def markdown(self) -> str:
        """Return the table in Markdown."""
        ruled = ["---", *["---:"] * (len(self.head) - 1)]
        return "\n".join(f"| {' | '.join(row)} |" for row in (list(self.head), ruled, *self.rows))


def held_out(pieces: Iterable[Piece], using: Sequence[Method]) -> Table:
    """Judge methods by the orientations of a recording that they were not given."""
    head = ("recording", "hours", "orientations", "raw", *(one.name for one in using))
    rows = []
    for piece in pieces:
        still = rests(piece)
        posture = postures(still)
        parts = list(folds(piece, still, posture))
        row = [piece.name, f"{piece.hours:.3g}", str(int(posture.max()) + 1)]
        row.append(_mg(_held_out_mg([RAW] * len(parts), parts, still, posture)))
        for one in using:
            found = one.calibrate([kept for kept, _ in parts]) if _takes(one, piece) else []
            row.append(_cell(found, parts, still, posture))
        rows.append(row)
    text = (
        "Mean | |a| - 1 g | [mg] of rests of 10 s in orientations that took no part: every method gets the "
        "rests of four fifths of a recording's orientations (15 degrees wide) and is judged on the others, "
        "five times. Each orientation counts the same. In brackets: in how many of the five the method "
        "accepts a calibration; raw values count where it does not. Filled and clipped samples are left out. "
        "six parameters: the method of van Hees et al. 2014, written for this page. skdh may calibrate from "
        "12 h on, where its default is 72 h."
    )
    return Table("held-out-orientations", text, head, rows)


def _cell(
    found: Sequence[Found | None], parts: Sequence[tuple[Piece, Rests]], still: Rests, posture: Places
) -> str:
    """Return the error of a method, with the number of calibrations if it is not all."""
    if not found:
        return "-"
    used = sum(one is not None for one in found)
    if not used:
        return "none"
    error = _held_out_mg([one or RAW for one in found], parts, still, posture)
    return _mg(error) + ("" if used == len(found) else f" ({used} of {len(found)})")


def _held_out_mg(
    found: Sequence[Found], parts: Sequence[tuple[Piece, Rests]], still: Rests, posture: Places
) -> float:
    """Return the mean over all orientations of the error that the fold without it leaves [mg]."""
    errors: dict[int, float] = {}
    for one, (_, held) in zip(found, parts, strict=True):
        which = posture[np.isin(still.number, held.number)]
        errors |= by_posture_mg(one, held, which)
    return float(np.mean(list(errors.values())))


def _takes(one: Method, piece: Piece) -> bool:
    return one.takes_rests or piece.rate_hz is not None


def stretches(piece: Piece, hours: float) -> Iterator[Piece]:
    """Yield pieces of a length, one after the other; only whole ones."""
    start = float(piece.seconds[0])
    while start + 3600 * hours <= float(piece.seconds[-1]) + 1:
        yield piece.cut((piece.seconds >= start) & (piece.seconds < start + 3600 * hours))
        start += 3600 * hours


def held_out_stretches(pieces: Iterable[Piece], using: Sequence[Method], lengths: Sequence[float]) -> Table:
    """Judge methods by the rests of a recording outside the stretch that they were given."""
    head = ("recording", "hours", "stretches", "raw", *(one.name for one in using))
    rows = []
    for piece in pieces:
        still = rests(piece)
        posture = postures(still)
        for hours in (one for one in lengths if 2 * one <= piece.hours + 0.1):
            parts = list(stretches(piece, hours))
            rest = [~np.isin(still.number, part.number) for part in parts]
            outside = [(still.cut(which), posture[which]) for which in rest]
            row = [piece.name, f"{hours:g}", str(len(parts)), _mg(_outside_mg([RAW] * len(parts), outside))]
            for one in using:
                found = one.calibrate(parts) if _takes(one, piece) else []
                row.append(_usable(found, _outside_mg([made or RAW for made in found], outside)))
            rows.append(row)
    text = (
        "Mean | |a| - 1 g | [mg] of rests outside of a stretch, calibrated by the stretch alone; each "
        "orientation counts the same. In brackets: share of the stretches from which the method accepts a "
        "calibration by its own rule; raw values count where it does not. The scatter of rests, about 2 mg "
        "on a wrist, remains with any method."
    )
    return Table("held-out-stretches", text, head, rows)


def _outside_mg(found: Sequence[Found], outside: Sequence[tuple[Rests, Places]]) -> float:
    errors = [
        np.mean(list(by_posture_mg(one, still, posture).values()))
        for one, (still, posture) in zip(found, outside, strict=False)
    ]
    return float(np.mean(errors)) if errors else float("nan")


def _usable(found: Sequence[Found | None], error_mg: float) -> str:
    if not found:
        return "-"
    share = sum(one is not None for one in found) / len(found)
    return f"{_mg(error_mg)} ({100 * share:.0f} %)"


@dataclass(frozen=True)
class Simulated:
    """A simulated recording, and its sensor: a = gain (v + offset_g)."""

    piece: Piece
    gain: Real
    offset_g: Real

    def error_mg(self, found: Found | None) -> float:
        """Return the true error over all orientations of a calibration, or of raw values [mg]."""
        celsius = 30.0 if self.piece.celsius is None else float(self.piece.celsius.mean())
        return everywhere_mg(found or RAW, self.gain, self.offset_g, celsius)


def simulated(folder: Path, days: float, seed: int, truth: int | None = None) -> Simulated:
    """Make a recording of simulated wear of a sensor whose errors are those of `truth`, else of `seed`."""
    path, told = accelcal.simulate(
        folder / "one", days=days, rate=RATE_HZ, seed=seed, truth=truth, force=True
    )
    piece, sensor = read(path), told["sensor"]
    return Simulated(piece, np.array(sensor["gain"]), np.array(sensor["offset_g"]))


def known_truth(recordings: Iterable[Simulated], using: Sequence[Method], lengths: Sequence[float]) -> Table:
    """Judge methods on sensors whose true parameters are known, by hours of wear."""
    judged: dict[tuple[float, str], list[tuple[Found | None, float]]] = {}
    for one in recordings:
        for hours in lengths:
            parts = list(stretches(one.piece, hours))
            for method in using:
                found = method.calibrate(parts)
                judged.setdefault((hours, method.name), []).extend(
                    (made, one.error_mg(made)) for made in found
                )
            raw: list[tuple[Found | None, float]] = [(None, one.error_mg(None))] * len(parts)
            judged.setdefault((hours, "raw"), []).extend(raw)
    rows = []
    for hours in lengths:
        raw = judged[hours, "raw"]
        cells = [_true_cell(judged[hours, one.name]) for one in using]
        row = [f"{hours:g}", str(len(raw)), _mg(float(np.mean([error for _, error in raw]))), *cells]
        rows.append([*row, f"{100 * _holding(judged[hours, 'accelcal']):.0f} %"])
    text = (
        "Mean true error over all orientations [mg] of sensors simulated by accelcal, which follow the model "
        "that it fits, calibrated by stretches of these lengths. In brackets: share that the method accepts; "
        "raw values count where it does not. Last column: how often the 95 % interval of accelcal holds the "
        "true error."
    )
    head = ("hours", "stretches", "raw", *(one.name for one in using), "intervals that hold")
    return Table("known-truth", text, head, rows)


def _true_cell(judged: Sequence[tuple[Found | None, float]]) -> str:
    found, errors = zip(*judged, strict=True)
    return _usable(found, float(np.mean(errors)))


def _holding(judged: Sequence[tuple[Found | None, float]]) -> float:
    """Return the share of the stated intervals that hold the true error."""
    stated = [(made.claimed, error) for made, error in judged if made is not None and made.claimed]
    return float(np.mean([low <= error <= high for (_, low, high), error in stated]))


def two_devices(pairs: Iterable[tuple[Simulated, Simulated]], using: Sequence[Method]) -> Table:
    """Compare what two devices say of one movement."""
    rows = []
    for number, pair in enumerate(pairs, 1):
        found = {"raw": (RAW, RAW)} | {
            one.name: one.calibrate([device.piece for device in pair]) for one in using
        }
        cells = []
        for both in found.values():
            first, second = (
                enmo_mg(one or RAW, device.piece) for one, device in zip(both, pair, strict=True)
            )
            minutes = [float((one >= 1000 * MVPA_G).sum()) * EPOCH_S / 60 for one in (first, second)]
            refused = "" if all(both) else " (not accepted)"
            cells.append(
                f"{_mg(float(np.abs(first - second).mean()))}, {abs(minutes[0] - minutes[1]):.1f}{refused}"
            )
        rows.append([str(number), *cells])
    text = (
        "Two simulated devices with different errors in one movement of a day: mean difference of their ENMO "
        "in epochs of 5 s [mg], and difference of the minutes with an ENMO of 100 mg or more."
    )
    return Table("two-devices", text, ("pair", "raw", *(one.name for one in using)), rows)


def enmo_mg(found: Found, piece: Piece) -> Real:
    """Return ENMO of each epoch [mg]."""
    length = np.sqrt((found(piece.xyz, piece.celsius) ** 2).sum(axis=1))
    per = int(EPOCH_S * RATE_HZ)
    whole = len(length) // per * per
    return np.asarray(1000 * np.maximum(length[:whole] - 1, 0).reshape(-1, per).mean(axis=1))


def speed(folder: Path, python: str) -> Table:
    """Time whole processes on a day of a simulated AX3 at 100 Hz."""
    path, out = folder / "day.cwa", folder / "out"
    ours = [python, "-m", "accelcal_cli"]
    made = [*ours, "simulate", str(path), "--format", "cwa", "--days", "1", "--seed", "3", "-q", "--force"]
    timed({"made": Command(made)}, 1)
    commands = {"accelcal": Command([*ours, "calibrate", str(path), "-d", str(out), "-q"], out)}
    commands |= peer_commands(peers_python(), "cwa", path)
    found = timed(commands, 3)
    rows = [
        [name, f"{one.wall_s:.1f}", f"{one.cpu_s:.1f}", f"{one.memory_mb:.0f}"] for name, one in found.items()
    ]
    text = (
        "Calibrating a day of a simulated AX3 at 100 Hz (`.cwa`) and writing Parquet: whole processes, "
        "medians of three."
    )
    return Table("speed", text, ("tool", "wall s", "CPU s", "memory MB"), rows)


def _mg(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}" if value < 10 else f"{value:.1f}"

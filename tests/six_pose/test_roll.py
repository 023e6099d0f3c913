"""The check of a calibration by a roll with one axis level: against numpy."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import UniformClock
from accelcal_cli.core.errors import DivergedError, Reason, UsageError
from accelcal_cli.core.gravity import STANDARD
from accelcal_cli.core.recording import Chunk, Validity
from accelcal_cli.six_pose.poses import Origin
from accelcal_cli.six_pose.run import RollResult, RollSums, judge_roll, rolls_of, span_of_roll, sums_of
from tests.six_pose.made import K, O

LSB = 1024.0
ORIGIN = Origin(0, True, None)


def about(axis: int, turns: float = 2.0, rows: int = 1000) -> np.ndarray:
    """What is true of a roll with an axis level, (n, 3) in g."""
    angle = np.linspace(0, 2 * np.pi * turns, rows)
    true = np.zeros((rows, 3))
    one, two = (other for other in range(3) if other != axis)
    true[:, one], true[:, two] = np.cos(angle), np.sin(angle)
    return true


def counts_of(true: np.ndarray) -> np.ndarray:
    noise = 0.004 * np.random.default_rng(1).standard_normal(true.shape)
    return np.rint((true @ K.T + O + noise) * LSB).astype(np.int16)


def chunks_of(counts: np.ndarray, rows: int = 1000, validity: np.ndarray | None = None) -> list[Chunk]:
    """At 100 Hz from 0 on."""
    whole = Chunk(0, counts, UniformClock(0, 0, Fraction(100)), 0, validity=validity)
    return [whole.part(first, min(first + rows, len(counts))) for first in range(0, len(counts), rows)]


def calibration() -> Calibration:
    gain = np.linalg.inv(K)
    lower = [gain[place] for place in ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))]
    fixed = [round(float(value) * ONE) for value in (*lower, *-O, 0, 0, 0)]
    upper = [round(float(gain[place]) * ONE) for place in ((0, 1), (0, 2), (1, 2))]
    return Calibration("12", tuple(fixed), None, STANDARD, (upper[0], upper[1], upper[2]))


def of_rows(counts: np.ndarray, text: str = "z,0,100", *, known: bool = True, rows: int = 1000) -> RollResult:
    (roll,) = rolls_of([text])
    span = span_of_roll(roll, [ORIGIN])
    sums = sums_of(chunks_of(counts, rows), span, ORIGIN)
    return judge_roll(roll, span, sums, LSB, calibration() if known else None)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_figures_are_those_of_all_rows(axis: int) -> None:
    counts = counts_of(about(axis))
    found = of_rows(counts, f"{'xyz'[axis]},0,100")
    raw = counts / LSB
    a = (raw - O) @ np.linalg.inv(K).T
    assert found.after is not None
    for figures, values in ((found.before, raw), (found.after, a)):
        assert figures.mean_g == pytest.approx(values[:, axis].mean(), abs=1e-8)
        assert figures.sd_g == pytest.approx(values[:, axis].std(), abs=1e-8)
        assert figures.length_g == pytest.approx(np.sqrt((values**2).sum(axis=1).mean()), abs=1e-8)
        others = np.delete(values, axis, axis=1)
        least = np.linalg.eigvalsh(np.cov(others.T, bias=True))[0]
        assert figures.turn_g == pytest.approx(np.sqrt(least), abs=1e-7)
    assert abs(found.before.mean_g) > 0.03
    assert abs(found.after.mean_g) < 0.001
    assert found.before.sd_g > 0.01
    assert found.after.sd_g < 0.006
    assert (found.samples, found.ends_us) == (1000, (0, 9_990_000))


@pytest.mark.parametrize("rows", [1, 7, 999])
def test_the_bits_do_not_depend_on_how_rows_are_cut(rows: int) -> None:
    counts = counts_of(about(2))
    assert of_rows(counts, rows=rows) == of_rows(counts)


def test_sums_are_exact_beyond_64_bits() -> None:
    random = np.random.default_rng(3)
    counts = random.integers(-(2**31), 2**31, (5000, 3)).astype(np.int32)
    counts[:2] = [[-(2**31)] * 3, [2**31 - 1] * 3]
    sums = RollSums()
    for part in np.array_split(counts, 3):
        sums.add(part, np.zeros(len(part), np.int64))
    exact = counts.astype(object)
    mean = [Fraction(int(value), 5000) for value in exact.sum(axis=0)]
    assert list(sums.mean_g(1.0)) == mean
    products = sums.products_g2(1.0)
    for i in range(3):
        for j in range(3):
            both = Fraction(int((exact[:, i] * exact[:, j]).sum()), 5000)
            assert products[i][j] == both - mean[i] * mean[j]


def test_only_rows_within_the_times_that_were_measured_count() -> None:
    counts = np.concatenate([counts_of(about(0)), counts_of(about(2))])
    validity = np.zeros(2000, np.uint8)
    validity[1500:1600] = Validity.RECOVERED
    (roll,) = rolls_of(["z,10,20"])
    span = span_of_roll(roll, [ORIGIN])
    sums = sums_of(chunks_of(counts, 300, validity), span, ORIGIN)
    kept = np.r_[counts[1000:1500], counts[1600:]] / LSB
    assert sums.samples == 900
    assert judge_roll(roll, span, sums, LSB, None).before.mean_g == pytest.approx(kept[:, 2].mean(), abs=1e-9)


def test_without_a_calibration_there_is_no_after() -> None:
    found = of_rows(counts_of(about(2)), known=False)
    assert found.after is None
    before = {"mean": round(1000 * found.before.mean_g, 4), "sd": round(1000 * found.before.sd_g, 4)}
    assert found.reason() == Reason("rolled", {"axis": "z", "before_mg": before, "after_mg": None})
    after = of_rows(counts_of(about(2))).reason().values["after_mg"]
    assert abs(after["mean"]) < 1 and after["sd"] > 0


@pytest.mark.parametrize(
    ("true", "words"),
    [
        (about(0), "--roll z,0,100: the device does not roll there by half a turn, with z level"),
        (about(2, turns=0.4), "does not roll there by half a turn"),
        (np.vstack([about(2), 0.9 * about(0)]), "does not roll there by half a turn"),
        (np.tile([1.0, 0, 0], (100, 1)), "does not roll there by half a turn"),
        (np.empty((0, 3)), "--roll z,0,100: nothing was measured there"),
    ],
)
def test_what_is_no_roll_is_refused(true: np.ndarray, words: str) -> None:
    with pytest.raises(DivergedError) as caught:
        of_rows(counts_of(true))
    assert words in str(caught.value)


def test_half_a_turn_is_enough() -> None:
    assert of_rows(counts_of(about(2, turns=0.55))).samples == 1000


@pytest.mark.parametrize("text", ["", "z", "z,", "w,1,2", "xy,1,2", ",1,2", "\x1b[31m,1,2"])
def test_an_option_without_axis_or_place_is_wrong_usage(text: str) -> None:
    with pytest.raises(UsageError, match="names no axis and place; write --roll AXIS,START,END"):
        rolls_of([text])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("z,1", "--roll z,1: has no start and end; write"),
        ("z,a.csv,1,2", "has no start and end"),
        ("z,1,x", "--roll z,1,x: 'x' is neither a number of seconds nor a time"),
        ("z,5,1", "--roll z,5,1: ends before it starts"),
        ("z,1,2024-03-04T12:00:00Z", "give --timezone"),
    ],
)
def test_times_that_are_none(text: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        span_of_roll(rolls_of([text])[0], [ORIGIN])
    assert words in str(caught.value)


def test_files_and_their_times() -> None:
    origins = [Origin(0, True, None, "a.csv"), Origin(7_000_000, True, None, "b,1,2")]
    spans = [
        span_of_roll(rolls_of([f"Y, {text}"])[0], origins) for text in ("b,1,2", "a.csv,3,4", "b,1,2,3,4.5")
    ]
    assert [(span.file, span.whole) for span in spans] == [(1, True), (0, False), (1, False)]
    assert [(span.start_us, span.end_us) for span in spans[1:]] == [
        (3_000_000, 4_000_000),
        (10_000_000, 11_500_000),
    ]
    for text, place in (("c.csv", "'c.csv' is not a"), ("1,2", "'1,2' is not a"), ("c,1,2", "'c' is not a")):
        with pytest.raises(UsageError, match=place):
            span_of_roll(rolls_of([f"z,{text}"])[0], origins)


def test_an_origin_holds_its_own_samples_only() -> None:
    counts = np.concatenate([counts_of(about(2)), counts_of(about(0))])
    origins = [
        Origin(0, True, None, "a", 0, 1000),
        Origin(10_000_000, True, None, str(Path("b")), 1000, 2000),
    ]
    (roll,) = rolls_of(["z,a"])
    sums = sums_of(chunks_of(counts), span_of_roll(roll, origins), origins[0])
    assert sums.samples == 1000

"""`make validation`: the six parameters of van Hees et al., what is held out, and the tables of the docs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tools.validation import __main__ as validation
from tools.validation import six_parameters
from tools.validation.found import RAW, Found, everywhere_mg, sphere
from tools.validation.methods import _ours
from tools.validation.samples import WINDOW_S, Piece, Rests, folds, postures, read, rests, table
from tools.validation.six_parameters import autocalibrated, fitted
from tools.validation.tables import Table, held_out

SAMPLES = Path(__file__).resolve().parent.parent / "sample_data"
SCALE, OFFSET, SLOPE = np.array([1.02, 0.97, 1.01]), np.array([0.05, -0.03, 0.02]), np.array([1e-3, 0, -2e-3])


def measured(directions: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """What a sensor with these errors measures at rest: a = scale v + offset + slope (T - 30)."""
    return (directions - OFFSET - np.outer(celsius - 30, SLOPE)) / SCALE


def test_51_5_six_parameters_of_a_known_sensor_are_found() -> None:
    directions, celsius = sphere()[::4], 30 + 5 * np.sin(np.arange(500.0))
    found = fitted(Rests(np.arange(500), measured(directions, celsius), celsius))
    assert found is not None
    assert np.diag(found.matrix) == pytest.approx(SCALE, abs=1e-4)
    assert found.constant + 30 * found.per_c == pytest.approx(OFFSET, abs=1e-4)
    assert found.per_c == pytest.approx(SLOPE, abs=1e-5)


def test_51_5_six_parameters_are_not_accepted_without_both_sides_of_each_axis() -> None:
    half = sphere()[sphere()[:, 2] > -0.2]
    assert fitted(Rests(np.arange(len(half)), half, None)) is None


def test_51_5_six_parameters_are_those_of_ggir(real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the means of GGIR's own test data, for which its answer is known; it stops at larger steps."""
    piece = table(real_data / "points" / "geneactiv_84h_points.csv.gz", 84)
    still, ours = rests(piece), autocalibrated(piece)
    monkeypatch.setattr(six_parameters, "SMALL", 3e-6)
    found = autocalibrated(piece)
    assert found is not None and ours is not None and still.celsius is not None
    at_mean = found.constant + found.per_c * still.celsius.mean()
    assert np.diag(found.matrix) == pytest.approx([1.00087, 0.99525, 0.99773], abs=2e-4)
    assert at_mean == pytest.approx([-0.00681, 0.00376, 0.01529], abs=2e-4)
    assert found.per_c == pytest.approx([0.00099, 0.00038, 0.00134], abs=5e-5)
    assert 1000 * found.error_g(still) == pytest.approx(2.294, abs=0.01)
    assert ours.error_g(still) < found.error_g(still), "the fair comparison is with the better one"


def test_51_5_a_held_out_orientation_is_in_no_sample_that_a_method_gets() -> None:
    piece = read(SAMPLES / "recording.bin")
    still = rests(piece)
    posture, seen = postures(still), 0
    for kept, held in folds(piece, still, posture):
        assert not np.isin(np.floor(kept.seconds / WINDOW_S), held.number).any()
        assert not set(posture[np.isin(still.number, held.number)]) & set(postures_of(kept, still, posture))
        seen += len(held.number)
    assert seen == len(still.number)


def postures_of(kept: Piece, still: Rests, posture: np.ndarray) -> np.ndarray:
    return posture[np.isin(still.number, kept.number)]


def test_51_5_the_true_parameters_have_no_error_and_accelcal_comes_close() -> None:
    gain, offset = np.diag(SCALE), OFFSET / SCALE
    exact = Found(gain, gain @ offset, np.zeros(3))
    assert everywhere_mg(exact, gain, offset, 30.0) < 1e-9
    assert everywhere_mg(RAW, gain, offset, 30.0) > 10
    (found,) = _ours([read(SAMPLES / "night.h5")])
    assert found is not None and found.claimed is not None and found.claimed[1] <= found.claimed[2]


@pytest.mark.nightly
def test_51_5_figures_of_the_docs_are_those_measured() -> None:
    """Rows of sample_data, by the methods that need nothing else; other columns are of `make validation`."""
    using = [one for one in validation.methods() if one.name in ("accelcal", "six parameters")]
    measured = held_out([read(SAMPLES / name) for name in validation.SAMPLES], using)
    there = validation.block(measured.name).search(validation.DOCS.read_text("utf-8"))
    assert there is not None
    lines = {
        line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ") for line in there[2].splitlines()
    }
    for row in measured.rows:
        assert lines[row[0]][: len(row)] == row


def test_51_5_tables_of_the_docs_that_differ_are_named_or_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    docs = tmp_path / "compared.md"
    docs.write_text("before\n<!-- make validation: a -->\n\n| x | y |\n| 0 |\n\n<!-- end -->\nafter\n")
    monkeypatch.setattr(validation, "DOCS", docs)
    new = Table("a", "", ("x", "y"), [["1", "2"]])
    validation.compare([new], replace=False)
    assert "differs from what was measured: a" in capsys.readouterr().out
    validation.compare([new], replace=True)
    assert docs.read_text() == (
        "before\n<!-- make validation: a -->\n\n| x | y |\n| --- | ---: |\n| 1 | 2 |\n\n<!-- end -->\nafter\n"
    )
    validation.compare([new], replace=False)
    assert capsys.readouterr().out == ""

"""Truth files of both kinds, as `simulate.py` reads them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.simulate import true_parameters

GAIN = [[1.5, 0.0, 0.0], [0.25, 1.0, 0.0], [0.0, -0.125, 0.75]]


def write(folder: Path, known: object) -> Path:
    (folder / "week.truth.json").write_text(json.dumps(known))
    return folder / "week.csv.gz"


def test_there_may_be_none(tmp_path: Path) -> None:
    assert true_parameters(tmp_path / "week.csv") is None


def test_as_simulate_writes_it(tmp_path: Path) -> None:
    sensor = {"gain": GAIN, "offset_g": [0.5, -0.25, 0.125], "reference_c": 30.0}
    found = true_parameters(write(tmp_path, {"sensor": sensor}))
    assert found is not None
    assert (found.gain.tolist(), found.offset_g.tolist(), found.reference_c) == (
        GAIN,
        [0.5, -0.25, 0.125],
        30,
    )


def test_the_other_kind_has_the_offset_with_the_other_sign(tmp_path: Path) -> None:
    found = true_parameters(write(tmp_path, {"K": GAIN, "b": [0.5, -0.25, 0.125], "temp_ref_c": 25.0}))
    assert found is not None
    assert (found.gain.tolist(), found.offset_g.tolist(), found.reference_c) == (
        GAIN,
        [-0.5, 0.25, -0.125],
        25,
    )


def test_slopes_are_read_where_there_are_any(tmp_path: Path) -> None:
    """The other kind subtracts them as it does its offset."""
    other = {"K": GAIN, "b": [0.5, 0, 0], "temp_ref_c": 30.0, "temp_slope_g_per_c": [0.5, -0.25, 0.0]}
    sensor = {"gain": GAIN, "offset_g": [-0.5, 0, 0], "reference_c": 30.0, "slope_g_per_c": [-0.5, 0.25, 0.0]}
    for known in (other, {"sensor": sensor}):
        found = true_parameters(write(tmp_path, known))
        assert found is not None and found.slope_g_per_c.tolist() == [-0.5, 0.25, 0.0]
    sensor["slope_g_per_c"] = [1.0]
    with pytest.raises(UnreadableError):
        true_parameters(write(tmp_path, {"sensor": sensor}))


@pytest.mark.parametrize("known", [{}, [], {"K": [1], "b": [0, 0, 0]}, {"K": GAIN, "b": ["x", 0, 0]}, 3])
def test_anything_else_is_said(tmp_path: Path, known: object) -> None:
    with pytest.raises(UnreadableError, match=r"week\.truth\.json"):
        true_parameters(write(tmp_path, known))


def test_text_that_is_no_json_is_said(tmp_path: Path) -> None:
    (tmp_path / "week.truth.json").write_bytes(b"\xff{")
    with pytest.raises(UnreadableError):
        true_parameters(tmp_path / "week.cwa")

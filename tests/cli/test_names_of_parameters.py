"""One convention of names: k_RC is in row R and column C of K, in reports and tables; older ones are read."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.output.report_reading import read_document
from tests.cli.run import run
from tests.cli.studies import rows, study
from tests.device_recordings import donor, edit, set_coefficients, week
from tests.recordings import GAIN, OFFSET_G, good_csv

Capture = pytest.CaptureFixture[str]
FIRST = {
    "k_xx": "kxx", "k_yy": "kyy", "k_zz": "kzz", "k_yx": "kxy", "k_zx": "kxz", "k_zy": "kyz",
    "k_xy": "kyx", "k_xz": "kzx", "k_yz": "kzy",
}  # fmt: skip
"""Names of schema version 1: those of the paper."""

PLACES = {f"k_{r}{c}": (row, column) for row, r in enumerate("xyz") for column, c in enumerate("xyz")}


def report(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def first_names(calibration: dict[str, Any]) -> None:
    """What a report of schema version 1 calls a calibration's parameters."""
    integers = calibration["fixed_point"]
    for outer, name in (
        (calibration, "parameters"),
        (calibration, "standard_errors"),
        (integers, "parameters"),
    ):
        outer[name] = outer[name] and {FIRST.get(one, one): value for one, value in outer[name].items()}


CAME_LATER = (
    "recording.time_zone", "settings.min_distance_g", "settings.input.force_timezone",
    "coverage.distinct_orientations", "file_health.rest", "holdout.improvement_factor",
    "without_misalignment",
)  # fmt: skip
"""What reports of accelcal 0.1.0, the last of schema version 1, did not have."""


def without_later(held: dict[str, Any]) -> None:
    """A report, or what a Parquet file says of itself, as version 0.1.0 wrote it."""
    held["accelcal_version"] = "0.1.0"
    first_names(held["calibration"])
    for place in CAME_LATER:
        *outer, name = place.split(".")
        inner = held
        for key in outer:
            inner = inner.get(key, {})
        inner.pop(name, None)


def as_first(path: Path) -> Path:
    """A report, and the Parquet file beside it, as version 0.1.0 wrote them."""

    def change(held: dict[str, Any]) -> None:
        held["schema_version"] = 1
        without_later(held)

    table_path = path.with_name(path.name.replace(".calibration.json", ".calibrated.parquet"))
    if table_path.exists():
        table = pq.read_table(table_path)
        metadata = json.loads(table.schema.metadata[b"accelcal"])
        without_later(metadata)
        pq.write_table(
            table.replace_schema_metadata({b"accelcal": json.dumps(metadata).encode()}), table_path
        )
    return edit(path, change)


def test_a_name_says_row_and_column_in_report_and_table(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "in").mkdir()
    path = good_csv(tmp_path / "in")
    assert study(capsys, tmp_path / "in").code == 0
    (row,), held = rows(tmp_path / "out"), report(tmp_path / "out" / "good.calibration.json")["calibration"]
    assert held["equation"] == "a = K (v + o + s (T - Tref))"
    for name, (r, c) in PLACES.items():
        assert float(row[name]) == held["gain"][r][c] == held["parameters"].get(name, 0.0)
        assert held["gain"][r][c] == pytest.approx(GAIN[r, c], abs=1e-3)
    assert float(row["k_xy"]) == 0.0 != float(row["k_yx"])
    raw = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(1, 2, 3), max_rows=2000)
    x, y = (raw[:, axis] + held["parameters"][f"o{name}"] for axis, name in enumerate("xy"))
    written = pq.read_table(tmp_path / "out" / "good.calibrated.parquet")["y"].to_numpy()[:2000]
    expected = held["parameters"]["k_yx"] * x + held["parameters"]["k_yy"] * y
    assert np.abs(written - expected).max() < 1e-6


def test_a_full_gain_has_the_names_above_the_diagonal_too(tmp_path: Path, capsys: Capture) -> None:
    gain = GAIN + np.triu([[0, 0.004, -0.003], [0, 0, 0.002], [0, 0, 0]])
    edit(coefficients := donor(tmp_path), lambda held: set_coefficients(held, gain, OFFSET_G))
    path = week(tmp_path / "other.raw", seed=2, poses=12)
    assert run(capsys, "apply", "--coefficients", coefficients, path).code == 0
    held = report(tmp_path / "other.calibration.json")["calibration"]
    for name, (r, c) in PLACES.items():
        assert held["parameters"][name] == held["gain"][r][c] == pytest.approx(gain[r, c], abs=1e-8)
    (tmp_path / "new").mkdir()
    edit(coefficients, lambda held: held.update(schema_version=1) or first_names(held["calibration"]))
    assert run(capsys, "apply", "--coefficients", coefficients, path, "-d", tmp_path / "new").code == 0
    assert report(tmp_path / "new" / "other.calibration.json")["calibration"] == held


def test_a_first_report_is_verified_with_its_parquet(tmp_path: Path, capsys: Capture) -> None:
    path, first = tmp_path / "donor.raw", as_first(donor(tmp_path))
    assert "kxy" in report(first)["calibration"]["parameters"]
    ran = run(capsys, "verify", first, path, "--values")
    assert (ran.code, ran.out.split("\t")[1], ran.out.split("\t")[-1].strip()) == (0, "identical", "-"), ran
    edit(first, lambda held: held["calibration"]["parameters"].update(kxy=0.5))
    ran = run(capsys, "verify", first, path, "--json")
    assert (ran.code, "calibration.parameters.k_yx" in json.loads(ran.out)["differs"]) == (1, True), ran


def test_a_first_report_of_apply_is_verified(tmp_path: Path, capsys: Capture) -> None:
    """Its coefficients' file is of the first version too, and known by its hash."""
    coefficients, path = as_first(donor(tmp_path)), week(tmp_path / "other.raw", seed=2, poses=12)
    assert run(capsys, "apply", "--coefficients", coefficients, path).code == 0
    ran = run(capsys, "verify", as_first(tmp_path / "other.calibration.json"), path)
    assert (ran.code, ran.out.split("\t")[1]) == (0, "identical"), ran


def test_a_first_report_gives_its_coefficients(tmp_path: Path, capsys: Capture) -> None:
    coefficients, path = donor(tmp_path), week(tmp_path / "other.raw", seed=2, poses=12)
    assert run(capsys, "apply", "--coefficients", coefficients, path, "-d", tmp_path / "now").code == 0
    as_first(coefficients)
    assert run(capsys, "apply", "--coefficients", coefficients, path, "-d", tmp_path / "then").code == 0
    now, then = (report(tmp_path / name / "other.calibration.json") for name in ("now", "then"))
    assert now["calibration"] == then["calibration"] and now["holdout"] == then["holdout"]
    tables = [pq.read_table(tmp_path / name / "other.calibrated.parquet") for name in ("now", "then")]
    assert pa.Table.equals(*tables)
    ran = run(capsys, "verify", tmp_path / "then" / "other.calibration.json", path, "--values")
    assert (ran.code, ran.out.split("\t")[1]) == (0, "identical"), ran


@pytest.mark.parametrize("place", CAME_LATER)
def test_what_came_later_is_missing_in_a_first_report_only(
    tmp_path: Path, capsys: Capture, place: str
) -> None:
    """A report of this version without it is damaged, or differs."""
    path = donor(tmp_path)

    def change(held: dict[str, Any]) -> None:
        *outer, name = place.split(".")
        for key in outer:
            held = held[key]
        del held[name]

    edit(path, change)
    (tmp_path / "donor.calibrated.parquet").unlink()
    assert run(capsys, "verify", path, tmp_path / "donor.raw").code in (1, 3)


def test_a_first_report_is_known_by_what_its_file_holds(tmp_path: Path) -> None:
    """Reports of pools and of lenders are named by the hash of their content."""
    path = as_first(donor(tmp_path))
    held = {name: value for name, value in report(path).items() if name != "provenance"}
    document = read_document(path)
    assert document.content_sha256 == hashlib.sha256(json.dumps(held, sort_keys=True).encode()).hexdigest()
    assert "k_yx" in document.report["calibration"]["parameters"]


def test_first_names_in_a_new_report_are_not_guessed_at(tmp_path: Path, capsys: Capture) -> None:
    """`kyx` is above the diagonal in the first version, and no name at all in the second."""
    coefficients = donor(tmp_path)
    edit(coefficients, lambda held: first_names(held["calibration"]))
    ran = run(capsys, "apply", "--coefficients", coefficients, tmp_path / "donor.raw", "-d", tmp_path / "out")
    assert (ran.code, "is a damaged report" in ran.err) == (3, True), ran


def test_a_study_redoes_first_reports_and_keeps_those_of_apply(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "given").mkdir()
    path, out = week(tmp_path / "in" / "own.raw", seed=2), tmp_path / "out"
    coefficients = donor(tmp_path / "given")
    other = week(tmp_path / "in" / "other.raw", seed=3, poses=12)
    assert run(capsys, "calibrate", path, "-d", out).code == 0
    assert run(capsys, "apply", "--coefficients", coefficients, other, "-d", out).code == 0
    new = report(out / "own.calibration.json")
    for name in ("own", "other"):
        as_first(out / f"{name}.calibration.json")
    assert study(capsys, tmp_path / "in").code == 0
    assert report(out / "own.calibration.json")["calibration"] == new["calibration"]
    assert report(out / "other.calibration.json")["schema_version"] == 1
    table = {row["path"]: row for row in rows(out)}
    gain = report(coefficients)["calibration"]["gain"]
    assert (table["other.raw"]["outcome"], float(table["other.raw"]["k_yx"])) == ("borrowed", gain[1][0])
    assert table["other.raw"]["se_k_yx"]
    assert run(capsys, "devices", out).code == 0

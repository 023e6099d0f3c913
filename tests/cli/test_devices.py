"""`accelcal devices` from outside."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from accelcal_cli.core.errors import spreadsheet_cell
from accelcal_cli.studies.columns import ALL, PARAMETERS
from tests.cli.run import assert_one_line, run
from tests.devices.made import drifting, fitted, good_devices, refused, start, write

Capture = pytest.CaptureFixture[str]
WARM = {f"slope_{axis}_g_per_c": 0.001 for axis in "xyz"}
COOL = WARM | {f"offset_{axis}_g": -0.003 for axis in "xyz"}
MIXED = [
    *good_devices(3, 4),
    *drifting("17440", 0.005), refused("17440", 500), fitted("warm", 0, WARM, model="9T"),
    fitted("warm", 30, COOL, model="6T", reference_c=27.0), fitted("warm", 60), fitted(None, 0),
    *(refused("dead", 30.0 * number, orientations=20) for number in range(3)), fitted("lost", None),
    {"path": "x.cwa", "outcome": "failed", "exit_code": 3, "message": "unreadable"},
]  # fmt: skip


def test_a_line_a_device_those_to_service_first(tmp_path: Path, capsys: Capture) -> None:
    ran = run(capsys, "devices", write(tmp_path, MIXED))
    assert ran.code == 0
    head, _, *lines = ran.lines
    assert head.split()[:4] == ["device", "recordings", "used", "refused"]
    assert [line.split()[0] for line in lines] == ["17440", "dead", "00000", "00001", "00002", "lost", "warm"]
    first = lines[0]
    assert first.split()[1:6] == ["9", "8", "1", start(0)[:10], start(500)[:10]]
    assert first.endswith(
        "+5.020 +- 0.016  +0.0000 +- 0.0016  service: offset x drifts by +5.020 +- 0.016 mg a month"
    )
    assert lines[1].endswith("service: 3 of 3 recordings refused or borrowed (other devices: 0 %)")
    assert lines[5].split()[1:] == ["1", "1", "0", "-", "-", "2.00", "undated", "undated", "good"]
    said = "7 devices: 2 service, 5 good; 2 recordings without a serial number, 1 of them failed"
    assert ran.err == f"accelcal: {said}\n"
    assert run(capsys, "devices", tmp_path, "-q").err == ""


def test_json_and_csv_hold_the_table(tmp_path: Path, capsys: Capture) -> None:
    out = write(tmp_path, MIXED)
    told = json.loads(run(capsys, "devices", out, "--json").out)
    rows = list(csv.DictReader(io.StringIO(run(capsys, "devices", out, "--csv").out)))
    table = {row["path"]: row for row in pq.read_table(out / "study.parquet").to_pylist()}
    history = [one for device in told["devices"] for one in device["history"]]
    assert [
        {k: "" if v is None else str(spreadsheet_cell(v)) for k, v in one.items()} for one in history
    ] == rows
    assert len(rows) == len(MIXED) - 2
    assert (told["recordings"], told["without_serial"], told["failed_without_serial"]) == (len(MIXED), 2, 1)
    for one in history:
        source = table[one["path"]]
        for name in ("start_time", "outcome", "model", "after_mg", "message", "format"):
            assert one[name] == source[name]
        for name in PARAMETERS:
            free = source[f"se_{name}"] is not None
            assert one[f"se_{name}"] == source[f"se_{name}"]
            assert one[name] == (source[name] if free else None)
    (device,) = [one for one in told["devices"] if one["serial"] == "17440"]
    assert device["uses"] == {"refused": 1, "used": 8}
    assert device["parameters"]["offset_x"]["drift"]["freedom"] == 6
    (warm,) = [one for one in told["devices"] if one["serial"] == "warm"]
    assert warm["reference_c"] == 28.5
    moved = warm["history"][0]["offset_x_g_at_one_temperature"] - warm["history"][0]["offset_x_g"]
    assert moved == pytest.approx(-1.5 * 0.001)


def test_one_device_in_full(tmp_path: Path, capsys: Capture) -> None:
    ran = run(capsys, "devices", write(tmp_path, MIXED), "--device", "17440")
    assert ran.code == 0
    assert ran.lines[:2] == ["17440 (AX3, cwa): service", "  offset x drifts by +5.020 +- 0.016 mg a month"]
    (offset,) = [line.split() for line in ran.lines if line.startswith("offset x mg")]
    assert (offset[-1], offset[-2]) == ("yes", "8")
    assert sum(line.endswith(".cwa") for line in ran.lines) == 9
    told = json.loads(run(capsys, "devices", tmp_path, "--device", "17440", "--json").out)
    assert [device["serial"] for device in told["devices"]] == ["17440"]
    assert "offsets at 28.5 C" in run(capsys, "devices", tmp_path, "--device", "warm").lines
    at_20 = run(capsys, "devices", tmp_path, "--device", "warm", "--rule", "reference_c=20")
    assert "offsets at 20.0 C" in at_20.lines
    unknown = run(capsys, "devices", tmp_path, "--device", "17441")
    assert (unknown.code, unknown.out) == (2, "")
    assert_one_line(
        unknown, "no recording of device 17441", "there are 17440, dead, 00000, 00001, 00002, ..."
    )


@pytest.mark.parametrize(
    ("rows", "lines", "said"),
    [
        ([], 2, "0 devices"),
        ([fitted(None, 0)], 2, "0 devices; 1 recording without a serial number"),
        ([fitted("A", 0)], 3, "1 device: 1 good"),
        ([refused("A", 0)], 3, "1 device: 1 unknown"),
        ([refused(serial, day) for serial in "AB" for day in (0, 30, 60)], 4, "2 devices: 2 unknown"),
    ],
)
def test_little_to_go_by(tmp_path: Path, capsys: Capture, rows: list, lines: int, said: str) -> None:
    ran = run(capsys, "devices", write(tmp_path, rows))
    assert (ran.code, len(ran.lines), ran.err) == (0, lines, f"accelcal: {said}\n")
    assert json.loads(run(capsys, "devices", tmp_path, "--json").out)["recordings"] == len(rows)
    assert len(run(capsys, "devices", tmp_path, "--csv").lines) == lines - 1 + sum(
        row["device_serial"] is not None for row in rows
    ) - (lines - 2)
    for row in rows:
        if row["device_serial"]:
            assert run(capsys, "devices", tmp_path, "--device", row["device_serial"]).code == 0


@pytest.mark.nightly
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
@given(order=st.permutations(range(len(MIXED))))
def test_the_order_of_the_rows_does_not_matter(tmp_path: Path, capsys: Capture, order: list[int]) -> None:
    plain = run(capsys, "devices", write(tmp_path / "a", MIXED), "--json").out
    shuffled = write(tmp_path / "b", [MIXED[index] for index in order])
    assert run(capsys, "devices", shuffled, "--json").out == plain


def test_odd_names_are_shown_and_stop_nothing(tmp_path: Path, capsys: Capture) -> None:
    rows = [fitted("a\x1b[31m\nb", 0, path="d�/\t.cwa"), fitted("é, \"q\"", 0), refused("", 0)]  # fmt: skip
    out = write(tmp_path / "o\udcffut", rows)
    ran = run(capsys, "devices", out)
    assert ran.code == 0
    assert "\x1b" not in ran.out and len(ran.lines) == 4
    assert json.loads(run(capsys, "devices", out, "--json").out)["without_serial"] == 1
    held = list(csv.DictReader(io.StringIO(run(capsys, "devices", out, "--csv").out)))
    assert [row["serial"] for row in held] == ["a\\x1b[31m\\nb", "é, \"q\""]  # fmt: skip
    assert run(capsys, "devices", out, "--device", "a\x1b[31m\nb").code == 0
    assert_one_line(run(capsys, "devices", out, "--device", "x\udcff"), "no recording of device")
    assert_one_line(run(capsys, "devices", tmp_path / "no\udcff\n"), "does not exist")


ODD = st.sampled_from([1e-300, 5e-324, 1e-160, 1e160, 1e300, -1e300, np.inf, -np.inf, np.nan, 0.0, -1.0])
NUMBERS = [column.name for column in ALL if column.kind == "number"]


@pytest.mark.nightly
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(st.lists(st.tuples(st.integers(0, 99), st.sampled_from(NUMBERS), ODD), min_size=1, max_size=60))
def test_odd_numbers_stop_nothing(
    tmp_path: Path, capsys: Capture, damage: list[tuple[int, str, float]]
) -> None:
    rows = [dict(row) for row in MIXED]
    for number, name, value in damage:
        rows[number % len(rows)][name] = value
    out = write(tmp_path, rows)
    told = run(capsys, "devices", out, "--json", "-q")
    assert (told.code, told.err) == (0, "")
    assert "NaN" not in told.out and "Infinity" not in told.out
    for words in ([], ["--csv"], ["--device", "17440"], ["--device", "warm"]):
        assert run(capsys, "devices", out, *words).code == 0


def test_one_serial_of_two_makers_is_two_devices(tmp_path: Path, capsys: Capture) -> None:
    other = {"device_model": "GENEActiv", "format": "geneactiv"}
    ran = run(capsys, "devices", write(tmp_path, [fitted("7", 0), fitted("7", 30, **other)]))
    assert [line.split("  ")[0] for line in ran.lines[2:]] == ["7 (AX3, cwa)", "7 (GENEActiv, geneactiv)"]
    assert run(capsys, "devices", tmp_path, "--device", "7").out.count("): good") == 2


@pytest.mark.parametrize("words", [
    ["--json", "--csv"], ["--rule", "drift_mg=0"], ["--rule", "reference_c=nan"], ["--rule", "drift_mg=x"],
    ["--rule", "drift"], ["--rule", "x=1"], ["extra"],
])  # fmt: skip
def test_wrong_words(tmp_path: Path, capsys: Capture, words: list) -> None:
    ran = run(capsys, "devices", write(tmp_path, MIXED), *words)
    assert (ran.code, ran.out) == (2, "")


def test_no_study_and_no_table(tmp_path: Path, capsys: Capture) -> None:
    ran = run(capsys, "devices", tmp_path)
    assert (ran.code, ran.out) == (2, "")
    assert_one_line(ran, "is not the output folder of a study: no study.parquet", "`accelcal study` with -d")
    (tmp_path / "study.parquet").write_bytes(b"PAR1 no table")
    ran = run(capsys, "devices", tmp_path)
    assert (ran.code, ran.out) == (3, "")
    assert_one_line(ran, "cannot be read", "run the study again")

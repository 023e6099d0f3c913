"""Light, battery and the like in the calibrated data: everywhere the same, and off by one option."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import accelcal
from tests.cli.run import report_of, run
from tests.recordings import RATE_HZ, directions, good_csv, still_counts, write_csv

POSES = directions(60)
NAMES = ["time", "x", "y", "z", "validity"]


def with_columns(path: Path, names: str, cells: list[str]) -> Path:
    """The recording of a text file, with further columns."""
    head, *rows = path.read_text().splitlines()
    lines = (f"{row},{cell}" for row, cell in zip(rows, cells, strict=True))
    path.write_text("\n".join([f"{head},{names}", *lines]) + "\n")
    return path


def lit(folder: Path, poses: np.ndarray = POSES, name: str = "lit.csv") -> tuple[Path, np.ndarray]:
    """A good recording with light of every fifth row, and a battery's voltage once a minute."""
    path = write_csv(folder / name, still_counts(poses))
    rows = len(path.read_text().splitlines()) - 1
    light = np.where(np.arange(rows) % 5 == 0, np.arange(rows) % 1024, np.nan)
    minute = round(60 * RATE_HZ)
    volts = np.where(np.arange(rows) % minute == 0, 4.1 - np.arange(rows) / rows, np.nan)
    cells = ["" if np.isnan(one) else repr(one) for one in light.tolist()]
    more = ["" if np.isnan(one) else repr(one) for one in volts.tolist()]
    with_columns(path, "Light (lux),vbat_V", [",".join(both) for both in zip(cells, more, strict=True)])
    return path, np.stack([light, volts], axis=1).astype(np.float32)


def values(table: pa.Table, *names: str) -> np.ndarray:
    return np.stack([table[name].to_numpy() for name in names], axis=1)


def test_they_are_columns_of_the_calibrated_data(tmp_path: Path) -> None:
    path, known = lit(tmp_path)
    run("calibrate", path, "-d", tmp_path / "out", code=0)
    table = pq.read_table(tmp_path / "out" / "lit.calibrated.parquet")
    assert table.schema.names == [*NAMES[:4], "light", "battery", "validity"]
    fields = [table.schema.field(name) for name in ("light", "battery")]
    assert [(one.type, one.metadata[b"unit"]) for one in fields] == [
        (pa.float32(), b"lux"),
        (pa.float32(), b"V"),
    ]
    np.testing.assert_array_equal(values(table, "light", "battery"), known)
    assert "only_motion" not in report_of(tmp_path / "out" / "lit.calibration.json")["settings"]["input"]


def test_one_option_leaves_them_out(tmp_path: Path) -> None:
    path, _ = lit(tmp_path)
    run("calibrate", path, "-d", tmp_path / "all", code=0)
    run("calibrate", path, "-d", tmp_path / "bare", "--only-motion", code=0)
    whole, bare = (pq.read_table(tmp_path / one / "lit.calibrated.parquet") for one in ("all", "bare"))
    assert bare.schema.names == NAMES
    assert whole.select(NAMES).equals(bare)
    one, two = (report_of(tmp_path / name / "lit.calibration.json") for name in ("all", "bare"))
    assert two["settings"]["input"].pop("only_motion") is True
    assert [{**report, "provenance": None} for report in (one, two)] == [{**one, "provenance": None}] * 2
    run("calibrate", path, "-d", tmp_path / "bare", code=0)  # another option is another result
    assert pq.read_schema(tmp_path / "bare" / "lit.calibrated.parquet").names == whole.schema.names


def test_a_study_leaves_them_out_of_some_files(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    lit(folder, name="a.csv")
    lit(folder, name="b.csv")
    (folder / "study.toml").write_text('["b*"]\nonly_motion = true\n')
    run("study", folder, "-d", tmp_path / "out", "--jobs", 1, code=0)
    schemas = {name: pq.read_schema(tmp_path / "out" / f"{name}.calibrated.parquet").names for name in "ab"}
    assert schemas == {"a": [*NAMES[:4], "light", "battery", "validity"], "b": NAMES}


def test_python_gives_them_as_well(tmp_path: Path) -> None:
    path, known = lit(tmp_path)
    names = ["light", "battery"]
    result = accelcal.calibrate(path)
    np.testing.assert_array_equal(result.to_pandas()[names].to_numpy(), known)
    with accelcal.read(path, chunk_samples=1000) as reading:
        np.testing.assert_array_equal(reading.to_pandas()[names].to_numpy(), known)
        assert [one.unit for one in reading.recording.others] == ["lux", "V"]
    assert "light" not in accelcal.calibrate(path, only_motion=True).to_pandas()
    with accelcal.read(path, only_motion=True) as reading:
        assert next(iter(reading)).others == {}


def test_known_coefficients_keep_them_and_a_report_is_verified(tmp_path: Path) -> None:
    path, known = lit(tmp_path)
    report = tmp_path / "out" / "lit.calibration.json"
    run("calibrate", path, "-d", tmp_path / "out", code=0)
    run("apply", path, "--coefficients", report, "-d", tmp_path / "applied", code=0)
    table = pq.read_table(tmp_path / "applied" / "lit.calibrated.parquet")
    np.testing.assert_array_equal(values(table, "light", "battery"), known)
    run("verify", report, path, "--values", code=0)


def test_a_refused_recording_keeps_them(tmp_path: Path) -> None:
    path, known = lit(tmp_path, np.repeat(directions(60)[:1], 20, axis=0))
    run("calibrate", path, "-d", tmp_path, "--keep-refused")
    table = pq.read_table(tmp_path / "lit.uncalibrated.parquet")
    np.testing.assert_array_equal(values(table, "light", "battery"), known)


def test_a_column_that_breaks_off_in_text_changes_no_row(tmp_path: Path) -> None:
    """The first pass does not read it, and what is written has the same rows."""
    path = good_csv(tmp_path)
    rows = len(path.read_text().splitlines()) - 1
    cells = ["3.9"] * rows
    cells[rows // 2] = "low"
    with_columns(path, "battery", cells)
    run("calibrate", path, "-d", tmp_path / "out", code=0)
    column = pq.read_table(tmp_path / "out" / "good.calibrated.parquet")["battery"].to_numpy()
    assert len(column) == rows and np.flatnonzero(np.isnan(column)).tolist() == [rows // 2]
    assert not report_of(tmp_path / "out" / "good.calibration.json")["file_health"]["problems"]


def test_parts_have_the_columns_of_all(tmp_path: Path) -> None:
    counts, folder = still_counts(directions(60)), tmp_path / "parts"
    folder.mkdir()
    half = len(counts) // 2
    whole = write_csv(tmp_path / "whole.csv", counts).read_text().splitlines()
    for name, rows, column in (
        ("p_1.csv", whole[1 : half + 1], "light"),
        ("p_2.csv", whole[half + 1 :], "hr"),
    ):
        (folder / name).write_text("\n".join([f"{whole[0]},{column}", *(f"{row},7" for row in rows)]) + "\n")
    run("calibrate", "--parts", folder, "-d", tmp_path / "out", code=0)
    table = pq.read_table(next((tmp_path / "out").glob("*.calibrated.parquet")))
    light, rate = table["light"].to_numpy(), table["heart_rate"].to_numpy()
    assert (light[:half] == 7).all() and np.isnan(light[half:]).all()
    assert (rate[half:] == 7).all() and np.isnan(rate[:half]).all()


# Real recordings, by bytes at the places that their makers publish


@pytest.mark.parametrize("name", ["ax3_100hz_3min.cwa", "ax3_200hz_5min.cwa", "ax6_100hz_6min.CWA"])
def test_bytes_of_real_sectors(real_data: Path, name: str) -> None:
    """Light is the word at byte 18, the battery byte 23 of a sector (cwa.h of Open Movement)."""
    data = (real_data / "vendor" / name).read_bytes()[1024:]
    sectors = [
        data[at : at + 512] for at in range(0, len(data) // 512 * 512, 512) if data[at : at + 2] == b"AX"
    ]
    with accelcal.read(real_data / "vendor" / name) as reading:
        frame = reading.to_pandas()
    assert frame["light"].dropna().tolist() == [
        struct.unpack_from("<H", one, 18)[0] & 1023 for one in sectors
    ]
    volts = [(one[23] + 512) * 6 / 1024 for one in sectors]
    np.testing.assert_allclose(frame["battery"].dropna(), volts, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "volts", "lux"), [("geneactiv_66hz_22min.bin", 39, 140), ("geneactiv_85hz_1min.bin", 300, 800)]
)
def test_digits_of_real_pages(real_data: Path, name: str, volts: int, lux: int) -> None:
    """The last three digits of a sample are ten bits of light and the button (GENEActiv instructions)."""
    lines = (real_data / "vendor" / name).read_text("latin-1").splitlines()
    bodies = [line for line in lines if len(line) > 1000]
    cells = [int(body[at + 9 : at + 12], 16) for body in bodies for at in range(0, len(body) - 11, 12)]
    with accelcal.read(real_data / "vendor" / name) as reading:
        frame = reading.to_pandas()
    cells = cells[: len(frame)]
    assert frame["light"].tolist() == [(one >> 2) * lux // volts for one in cells]
    assert frame["button"].tolist() == [one >> 1 & 1 for one in cells]
    stated = [float(line.partition(":")[2]) for line in lines if line.startswith("Battery voltage:")]
    np.testing.assert_allclose(frame["battery"].dropna(), stated[: frame["battery"].count()], rtol=1e-6)


@pytest.mark.parametrize(
    "name", ["gt3x_waist_30hz_30min.gt3x", "gt3x_link_30hz_3h.gt3x", "gt3x_ism_enabled.gt3x"]
)
def test_records_of_real_logs(real_data: Path, name: str) -> None:
    """Each record of light, battery and capacitive sense is at the first sample of its second."""
    path = real_data / "vendor" / name
    with zipfile.ZipFile(path) as archive:
        log = archive.read("log.bin")
    stated: dict[str, dict[int, float]] = {}
    at = 0
    while at + 9 <= len(log):
        kind, second, size = log[at + 1], *struct.unpack_from("<IH", log, at + 2)
        for name_of, of, form, place in (
            ("light", 5, "<H", 0),
            ("battery", 2, "<H", 0),
            ("capsense", 13, "<H", 0),
            ("worn", 13, "<B", 4),
        ):
            if kind == of:
                stated.setdefault(name_of, {})[second] = struct.unpack_from(form, log, at + 8 + place)[0]
        at += 9 + size
    with accelcal.read(path) as reading:
        frame = reading.to_pandas()
    seconds = frame.index.tz_localize(None).to_numpy().astype("datetime64[us]").astype(np.int64)
    firsts = set((seconds[seconds % 1_000_000 == 0] // 1_000_000).tolist())
    offset = 0 if reading.recording.timezone is None else utc_offset(reading.recording.timezone)
    for name_of, values_of in stated.items():
        column = frame[name_of].to_numpy()
        found = {int(seconds[row]) / 1e6 + offset: column[row] for row in np.flatnonzero(~np.isnan(column))}
        per = 1000 if name_of == "battery" else 1
        known = {
            second: np.float32(value / per)
            for second, value in values_of.items()
            if second - offset in firsts
        }
        assert found == known and known, name_of


def utc_offset(zone: str) -> int:
    if zone == "UTC":
        return 0
    sign = -1 if zone.startswith("-") else 1
    return sign * (int(zone[1:3]) * 3600 + int(zone[4:6]) * 60)

"""The CSV reader on whole and healthy files, real ones among them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import NoRecordingError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats.tables import CSV as FORMAT
from tests.formats.make_csv import GRID, make, read, written

RNG = np.random.default_rng(3)
COUNTS = RNG.integers(-2048, 2048, (500, 3)).astype(np.int16)
STANDARD_GRAVITY = 9.80665


def score(path: Path) -> int:
    return FORMAT.sniff(probe_file(path, ReadOptions()))


def rows_of(path: Path, columns: tuple[int, ...]) -> np.ndarray:
    """Return columns of the first rows as numpy's own text parser reads them."""
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=columns, max_rows=200_000)


@pytest.mark.parametrize(
    "rate", [1.5625, 12.5, 30.0, 31.25, 33 + 1 / 3, 50.0, 75.0, 85.7, 99.2, 99.6, 102.4, 1000.0]
)
def test_rate_is_found_from_the_stamps(tmp_path: Path, rate: float) -> None:
    truth = make(tmp_path, COUNTS, rate, 256.0)
    assert read(truth.path).recording.rate_hz == pytest.approx(rate, rel=1e-5)


def test_chunks_can_be_read_twice_and_previewed(tmp_path: Path) -> None:
    truth = make(tmp_path, COUNTS, 100.0, 256.0)
    with FORMAT.open(truth.path, ReadOptions()) as reader:
        first, second = (np.concatenate([c.counts for c in reader.chunks(64)]) for _ in range(2))
        assert np.array_equal(first, second)
        assert sum(map(len, reader.preview(64, 2))) <= 128


def test_end_byte_reaches_the_end_of_plain_and_packed_files(tmp_path: Path) -> None:
    plain = make(tmp_path, COUNTS, 100.0, 256.0).path
    packed = written(tmp_path, gzip.compress(plain.read_bytes()), "b.csv.gz")
    for path in (plain, packed):
        with FORMAT.open(path, ReadOptions()) as reader:
            ends = [chunk.end_byte for chunk in reader.chunks(100)]
            assert ends == sorted(ends)
            assert ends[-1] == path.stat().st_size == reader.recording.total_bytes
    assert read(packed).same_as(read(plain))


def test_idle_zeros_do_not_hide_the_unit(tmp_path: Path) -> None:
    text = "0,0,0\n" * 80 + "0,0.01,1.01\n" * 20
    assert read(written(tmp_path, text), rate_hz=30.0).g[-1] == pytest.approx([0, 0.01, 1.01])


@pytest.mark.parametrize("value", ["64", "3", "0", "2.5", "300"])
def test_an_unclear_unit_is_asked_for(tmp_path: Path, value: str) -> None:
    path = written(tmp_path, f"0,0,{value}\n" * 20)
    with pytest.raises(UnreadableError, match="--unit g, mg or m/s2, or --unit counts with --lsb-per-g"):
        read(path, rate_hz=30.0)


def test_counts_stay_as_they_are(tmp_path: Path) -> None:
    path = written(tmp_path, "".join(f"{row},-3.0e1,{100 - row}.0\n" for row in range(20)))
    found = read(path, rate_hz=30.0, unit="counts", lsb_per_g=64.0)
    assert found.counts.tolist() == [[row, -30, 100 - row] for row in range(20)]
    assert found.recording.lsb_per_g == 64.0
    assert read(path, rate_hz=30.0, lsb_per_g=64.0).same_as(found)
    with pytest.raises(UsageError, match="--lsb-per-g"):
        read(path, rate_hz=30.0, unit="counts")


def test_fractions_of_counts_are_refused_with_their_line(tmp_path: Path) -> None:
    path = written(tmp_path, "x,y,z\n1,2,640\n\n1,2.5,640\n1,2,640\n")
    with pytest.raises(UnreadableError, match=r"line 4: 2\.5 is not a whole number of counts"):
        read(path, rate_hz=30.0, unit="counts", lsb_per_g=64.0)


def test_averages_of_counts_are_as_long_as_gravity_and_stay_fractions(tmp_path: Path) -> None:
    path = written(tmp_path, "x,y,z\n1,2,64\n1,2.5,64\n1,2,63.75\n")
    found = read(path, rate_hz=30.0, unit="counts", lsb_per_g=64.0)
    assert found.recording.lsb_per_g == GRID
    assert (found.g * 64).tolist() == [[1, 2, 64], [1, 2.5, 64], [1, 2, 63.75]]
    assert "unit: counts" in found.recording.notes


def test_whole_numbers_of_mg_are_counts_of_one_mg(tmp_path: Path) -> None:
    found = read(written(tmp_path, "x,y,z\n" + "10,-20,990\n" * 9), rate_hz=30.0)
    assert found.recording.lsb_per_g == 1000
    assert found.counts.tolist() == [[10, -20, 990]] * 9
    broken = read(written(tmp_path, "x,y,z\n" + "10,-20,990\n10,-20.5,990\n" * 9), rate_hz=30.0)
    assert broken.recording.lsb_per_g == GRID
    assert np.array_equal(broken.counts[1], np.rint(np.array([10, -20.5, 990]) * GRID / 1000))


@pytest.mark.parametrize("unit", ["deg/s", "dps", "G", "gauss", "uT", "V", "mV", "degrees", "rad/s", "m/s"])
def test_axes_in_a_unit_of_another_quantity_are_no_acceleration(tmp_path: Path, unit: str) -> None:
    names = ",".join(f"{axis} [{unit}]" for axis in "xyz")
    rows = "0.5,0.25,0.75\n" * 9
    with pytest.raises(NoRecordingError, match="no column has a name known for acceleration: x "):
        read(written(tmp_path, f"{names}\n{rows}"), rate_hz=30.0)
    both = f"{names},acc_x [g],acc_y [g],acc_z [g]\n" + "0.5,0.25,0.75,0,0,1\n" * 9
    assert read(written(tmp_path, both), rate_hz=30.0).g.tolist() == [[0, 0, 1]] * 9


@pytest.mark.parametrize("said", [{"rate_hz": 0.0}, {"rate_hz": float("nan")}, {"lsb_per_g": -1.0}])
def test_options_must_be_positive(tmp_path: Path, said: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="is not a positive number"):
        read(written(tmp_path, "0,0,1\n" * 9), **said)


def test_sniffing_knows_text_of_numbers_from_everything_else(tmp_path: Path) -> None:
    assert score(written(tmp_path, "time,x,y,z\n" + "2024-03-04 00:00:00,0,0,1\n" * 9)) == 60
    assert 30 <= score(written(tmp_path, "1;2;3\n" * 9, "a.dat")) <= 50
    assert score(written(tmp_path, gzip.compress(b"1,2,3\n" * 9), "a.csv.gz")) == 50
    assert score(written(tmp_path, bytes(range(256)) * 9)) == 0
    assert score(written(tmp_path, "Device Identity\nx,y,z\n" + "1,2,3\n" * 99)) == 0
    assert score(written(tmp_path, "some prose, with commas, in it\n" * 99)) == 0
    assert score(written(tmp_path, "1,2\n" * 99)) == 0
    assert score(written(tmp_path, RNG.bytes(3000).hex("\n", 50))) == 0
    dump = "\n".join(RNG.bytes(16).hex(" ", 1) for _ in range(200))
    assert score(written(tmp_path, dump)) == 0
    assert score(written(tmp_path, "\n".join(dump.splitlines()[:20]))) == 0


def test_real_actigraph_export_with_whole_seconds(real_data: Path) -> None:
    path = real_data / "vendor" / "actigraph_30hz_12h.csv.gz"
    found = read(path, 200_000)
    assert np.array_equal(found.counts[:200_000], np.rint(rows_of(path, (1, 2, 3)) * GRID))
    assert len(found.counts) == 1_296_000
    assert found.recording.rate_hz == 30.0
    assert found.recording.timezone == "UTC"
    assert (found.breaks, found.problems) == ([], [])
    even = 1_509_375_600_000_000 + (np.arange(len(found.times)) * 1_000_000 + 15) // 30
    assert np.array_equal(found.times, even)


@pytest.mark.nightly
def test_real_fourteen_days_of_epoch_seconds(real_data: Path) -> None:
    path = real_data / "vendor" / "zio_chest_1.56hz_14d.csv.gz"
    found = read(path, 300_000)
    truth = rows_of(path, (0, 1, 2, 3))
    assert np.array_equal(found.counts[:200_000], np.rint(truth[:, 1:] * GRID))
    assert np.array_equal(found.times[:200_000], np.rint(truth[:, 0] * 1000).astype(np.int64) * 1000)
    assert len(found.counts) == 1_888_164
    assert found.recording.rate_hz == pytest.approx(1.5609, abs=1e-4)


def test_real_imu_session_with_a_counter_column(real_data: Path) -> None:
    path = real_data / "imu" / "ferraris_session.csv"
    found = read(path, rate_hz=102.4, columns=("acc_x", "acc_y", "acc_z"), unit="m/s2")
    assert np.array_equal(found.counts, np.rint(rows_of(path, (4, 5, 6)) / STANDARD_GRAVITY * GRID))
    assert found.codes == ["no_start_time"]
    with pytest.raises(UnreadableError, match=r"-R time_column=none"):
        read(path, rate_hz=102.4, time_column="n_samples")


def test_real_imu_counts_between_blanks(real_data: Path) -> None:
    path = real_data / "imu" / "xsens_mti_acc.txt"
    found = read(path, unit="counts", lsb_per_g=415.0)
    truth = np.array([list(map(float, line.split())) for line in path.read_text().splitlines()])
    assert np.array_equal(found.counts, truth[:, 1:])
    assert np.array_equal(found.times, np.rint(truth[:, 0] * 1e6))
    assert found.recording.rate_hz == 100.0


def test_real_imu_log_of_six_columns_needs_to_be_told(real_data: Path) -> None:
    path = real_data / "imu" / "mpu9150_imu0.log"
    with pytest.raises(UnreadableError, match="--columns"):
        read(path)
    found = read(path, columns=("0", "1", "2"), rate_hz=100.0)
    truth = np.array([list(map(float, line.split()[:3])) for line in path.read_text().splitlines()])
    assert np.array_equal(found.counts, np.rint(truth / STANDARD_GRAVITY * GRID))

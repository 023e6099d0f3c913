"""Motion-BIDS: a table without a head, and the files beside it that describe it."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats.tables import CSV as FORMAT
from accelcal_cli.studies.discovery import Where, files
from tests.formats.make_csv import GRID, read
from tests.formats.reading import Read

STEM = "sub-01_ses-a_task-rest_tracksys-imu"
VALUES = np.array([(0.25 * row, -0.5, 9.75 + row / 64) for row in range(30)])
COUNTS = np.rint(VALUES / 9.80665 * GRID)
CHANNELS = [
    ("latency", "n/a", "LATENCY", "n/a", "s", "50"),
    ("s1_gyro_x", "x", "GYRO", "sternum", "rad/s", "50"),
    ("chan3", "z", "ACCEL", "sternum", "m/s^2", "50"),
    ("chan2", "y", "ACCEL", "sternum", "m/s^2", "50"),
    ("chan1", "x", "ACCEL", "sternum", "m/s^2", "50"),
    ("temperature", "n/a", "MISC", "n/a", "oC", "50"),
]
HEAD = ("name", "component", "type", "tracked_point", "units", "sampling_frequency")
START_US = 1_709_546_400_500_000
"""2024-03-04 10:00:00.5, by `date -u`."""


def table(lines: Any) -> str:
    return "".join("\t".join(map(str, line)) + "\n" for line in lines)


def rows(latency: bool = True) -> list[list[Any]]:
    found = []
    for row, (x, y, z) in enumerate(VALUES.tolist()):
        cells = [f"{row / 50:.3f}", 0.5, z, y, x, "n/a" if row == 4 else 25.5]
        found.append(cells if latency else cells[1:])
    return found


def laid_out(
    folder: Path,
    *,
    channels: Any = CHANNELS,
    about: dict[str, Any] | None = None,
    lines: list[list[Any]] | None = None,
    scans: str | None = None,
) -> Path:
    """Write a subject's folder; return the path of the motion file."""
    place = folder / "sub-01" / "ses-a" / "motion"
    place.mkdir(parents=True)
    (place / f"{STEM}_channels.tsv").write_text(table([HEAD, *channels]))
    about = {"SamplingFrequency": 50, "DeviceSerialNumber": "S7"} if about is None else about
    (place / f"{STEM}_motion.json").write_text(json.dumps(about))
    if scans is not None:
        listed = [("filename", "acq_time"), (f"motion/{STEM}_motion.tsv", scans)]
        (place.parent / "sub-01_ses-a_scans.tsv").write_text(table(listed))
    path = place / f"{STEM}_motion.tsv"
    path.write_text(table(rows() if lines is None else lines))
    return path


def test_the_sidecars_say_what_the_columns_are(tmp_path: Path) -> None:
    path = laid_out(tmp_path)
    found = read(path)
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [row * 20_000 for row in range(30)]
    assert found.temperature is not None and set(found.temperature.tolist()) == {25_500}
    about = found.recording
    assert (about.rate_hz, about.device.serial, about.start_us) == (50.0, "S7", None)
    assert about.companion == path.with_name(f"{STEM}_channels.tsv")
    assert about.notes[:2] == (
        "an export of Motion-BIDS",
        "x, y, z: column 4 ('chan1 [m/s^2]'), column 3 ('chan2 [m/s^2]'), column 2 ('chan3 [m/s^2]')",
    )
    assert found.codes == ["no_start_time", "missing_value"]
    assert found.problems[1].told == (
        "1 row without a temperature: the last one before holds, from line 5 on"
    )


@pytest.mark.parametrize("written", ["2024-03-04T10:00:00.500", "2024-03-04T10:00:00.5Z"])
@pytest.mark.parametrize("latency", [True, False])
def test_the_list_of_scans_has_the_start(tmp_path: Path, written: str, latency: bool) -> None:
    path = laid_out(
        tmp_path, channels=CHANNELS if latency else CHANNELS[1:], lines=rows(latency), scans=written
    )
    found = read(path)
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [START_US + row * 20_000 for row in range(30)]
    assert found.recording.start_us == START_US
    assert found.recording.timezone == ("UTC" if written.endswith("Z") else None)
    assert found.codes == ["missing_value"]


def test_the_rate_is_that_of_the_channels_or_of_the_recording(tmp_path: Path) -> None:
    without = [(*channel[:5], "n/a") for channel in CHANNELS[1:]]
    assert read(laid_out(tmp_path, channels=without, lines=rows(False))).recording.rate_hz == 50.0


def test_several_tracked_points_are_settled_by_columns(tmp_path: Path) -> None:
    twice = [*CHANNELS, *((f"t2_acc_{axis}", axis, "ACCEL", "thigh", "m/s^2", "50") for axis in "xyz")]
    lines = [[*line, 1.0, 2.0, 9.5] for line in rows()]
    path = laid_out(tmp_path, channels=twice, lines=lines)
    assert read(path, columns=("t2_acc_x", "t2_acc_y", "t2_acc_z")).g[0] == pytest.approx(
        np.array([1.0, 2.0, 9.5]) / 9.80665, abs=1e-7
    )
    assert np.array_equal(read(path, columns=("chan1", "chan2", "chan3")).counts, COUNTS)


def test_the_gyroscope_of_the_same_point(tmp_path: Path) -> None:
    """A gyroscope without all three axes does not count."""
    turns = [
        (f"c{point[0]}{axis}", axis, "GYRO", point, "deg/s", "50")
        for point in ("thigh", "sternum")
        for axis in "zyx"
    ]
    lines = [[*line, 3.0, 2.0, 1.0, 6.0, 5.0, row / 8] for row, line in enumerate(rows())]
    path = laid_out(
        tmp_path,
        channels=[*CHANNELS[:1], ("other", "n/a", "MISC", "n/a", "n/a", "50"), *CHANNELS[2:], *turns],
        lines=lines,
    )
    with FORMAT.open(path, ReadOptions()) as reader:
        (chunk,) = (chunk for chunk in reader.chunks(100) if len(chunk))
    assert reader.recording.gyro_dps_per_lsb == (1 / 65_536,) * 3
    assert chunk.gyro_counts is not None
    assert chunk.gyro_counts[:, 1:].tolist() == [[5 << 16, 6 << 16]] * 30
    assert chunk.gyro_counts[:, 0].tolist() == [row << 13 for row in range(30)]


def test_a_gap_of_the_latency_stays_a_gap(tmp_path: Path) -> None:
    found = read(laid_out(tmp_path, lines=rows()[:10] + rows()[20:]))
    assert (found.breaks, found.codes) == ([10], ["no_start_time", "clock_gap", "missing_value"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"channels": CHANNELS[:-1]}, r"has 6 columns, and .*_channels\.tsv describes 5"),
        ({"channels": [(*one[:2], "MAGN", *one[3:]) for one in CHANNELS]}, "no channels of type ACCEL"),
    ],
)
def test_sidecars_that_do_not_fit_are_named(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises(UnreadableError, match=words):
        read(laid_out(tmp_path, **change))


def test_a_damaged_sidecar_is_named(tmp_path: Path) -> None:
    path = laid_out(tmp_path)
    sidecar = path.with_suffix(".json")
    for text in ("{", "[" * 100_000, '{"SamplingFrequency": '):
        sidecar.write_text(text)
        with pytest.raises(UnreadableError, match=r"_motion\.json: is not valid JSON"):
            read(path)
    sidecar.unlink()
    assert np.array_equal(read(path).counts, COUNTS)


def test_a_study_notices_that_the_channels_changed(tmp_path: Path) -> None:
    path = laid_out(tmp_path / "in")
    where = Where((tmp_path / "in",), tmp_path / "out")
    (before,) = [item for item in files(where, []) if item.source.name == path.name]
    channels = path.with_name(f"{STEM}_channels.tsv")
    channels.write_text(channels.read_text() + "\n")
    (after,) = [item for item in files(where, []) if item.source.name == path.name]
    assert before.stamps[0] == after.stamps[0]
    assert before.stamps != after.stamps


def test_without_sidecars_it_is_a_table_like_any_other(tmp_path: Path) -> None:
    path = laid_out(tmp_path)
    path.with_name(f"{STEM}_channels.tsv").unlink()
    with pytest.raises(UnreadableError, match="--columns"):
        read(path)
    assert np.array_equal(read(path, columns=("4", "3", "2"), rate_hz=50.0, time_column="0").counts, COUNTS)


@pytest.mark.parametrize("mutants", [100, pytest.param(400, marks=pytest.mark.nightly)])
def test_damage_to_sidecars_gives_rows_or_an_error_of_ours(tmp_path: Path, mutants: int) -> None:
    path = laid_out(tmp_path, scans="2024-03-04T10:00:00.500")
    folder, chance = path.parent, random.Random(2)
    sidecars = [
        path.with_name(f"{STEM}_channels.tsv"),
        path.with_suffix(".json"),
        *folder.parent.glob("*.tsv"),
    ]
    sound = {sidecar: sidecar.read_bytes() for sidecar in sidecars}
    assert len(sound) == 3
    for _ in range(mutants):
        sidecar = chance.choice(sidecars)
        data = bytearray(sound[sidecar])
        for _ in range(chance.randint(1, 3)):
            at = chance.randrange(len(data))
            data[at : at + chance.choice([0, 1, 9, 50])] = chance.choice(
                [b"", b"\0", b"\t", b"\n", b'"', b"nan", b"-1e400", b"9" * 30, b"\xff", b"x"]
            )
        sidecar.write_bytes(bytes(data))
        try:
            found: Read | None = read(path)
        except AccelcalError as error:
            assert str(folder.parent) in str(error)
            found = None
        assert found is None or len(found.counts) == 30
        sidecar.write_bytes(sound[sidecar])

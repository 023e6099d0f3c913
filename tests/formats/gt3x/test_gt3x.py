"""ActiGraph recordings: samples, scale, clock and recognition, by the vendor's documents."""

from __future__ import annotations

import gzip
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import Device
from accelcal_cli.formats import find_format, open_recording
from accelcal_cli.formats.gt3x import sniff
from tests.formats.gt3x.reading import opened, random_counts, whole
from tests.formats.make_gt3x import (
    ACTIVITY,
    ACTIVITY2,
    ACTIVITY3,
    METADATA,
    START_S,
    START_US,
    activity,
    battery,
    encoded,
    info,
    packed,
    parameters,
    record,
    seconds,
    written,
    zipped,
)

VALUES = random_counts(500)
DOCUMENT_PACKED = bytes.fromhex("006008EBD007009EBF007008EBF0")
"""The example of LogRecords/Activity.md, three samples in the order y, x, z."""

DOCUMENT_WORDS = bytes.fromhex("0000000000003000ccff42010300faff0101")
"""The beginning of the example of LogRecords/Activity2.md."""


def test_the_documents_example_of_packed_samples(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", [record(ACTIVITY, START_S, DOCUMENT_PACKED)], info(3, 341.0))
    assert whole(path).counts.tolist() == [[8, 6, -323], [9, 7, -321], [8, 7, -321]]
    assert packed(whole(path).counts) == DOCUMENT_PACKED


def test_the_documents_example_of_words(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", [record(ACTIVITY2, START_S, DOCUMENT_WORDS)], info(3))
    assert whole(path).counts.tolist() == [[0, 0, 0], [48, -52, 322], [3, -6, 257]]


@pytest.mark.parametrize("kind", [ACTIVITY, ACTIVITY2, ACTIVITY3])
@pytest.mark.parametrize("rate", [25, 30, 50, 100])
def test_samples_of_every_kind_come_back(tmp_path: Path, kind: int, rate: int) -> None:
    path = written(tmp_path / "a.gt3x", seconds(VALUES, rate, kind), info(rate))
    found = whole(path)
    kept = len(VALUES) // rate * rate
    assert (found.counts[:kept] == VALUES[:kept]).all()
    assert found.counts.dtype == np.int16
    assert opened(path).recording.rate_hz == rate


def test_kinds_may_alternate(tmp_path: Path) -> None:
    kinds = (ACTIVITY, ACTIVITY2, ACTIVITY3)
    log = [activity(START_S + k, VALUES[50 * k : 50 * k + 50], kinds[k % 3]) for k in range(10)]
    assert (whole(written(tmp_path / "a.gt3x", log)).counts == VALUES).all()


def test_words_keep_all_sixteen_bits(tmp_path: Path) -> None:
    wide = np.array([[-32768, 32767, 0], [1, -1, 300]] * 25, np.int16)
    assert (whole(written(tmp_path / "a.gt3x", seconds(wide, 50))).counts == wide).all()


def test_records_of_all_other_kinds_are_skipped_by_their_length(tmp_path: Path) -> None:
    log = []
    for k, one in enumerate(seconds(VALUES, 50)):
        log += [record(10 * k + kind, START_S, b"\x1e" * (7 * k + kind)) for kind in (1, 4, 8, 29, 77)]
        log += [battery(START_S + k), one]
    found = whole(written(tmp_path / "a.gt3x", log))
    assert (found.counts == VALUES).all()
    assert (found.breaks, found.found) == ([], [])


def test_a_docked_device_and_a_few_zeros_are_no_samples_and_no_damage(tmp_path: Path) -> None:
    log = []
    for k, one in enumerate(seconds(VALUES, 50)):
        log += [one, record((ACTIVITY, ACTIVITY2)[k % 2], START_S, b"\x5a"), bytes(k % 9)]
    found = whole(written(tmp_path / "a.gt3x", log))
    assert (found.counts == VALUES).all()
    assert (found.breaks, found.found) == ([], [])


@pytest.mark.parametrize("rate", [30, 32, 70, 100])
def test_each_sample_has_its_second_and_its_part_of_it(tmp_path: Path, rate: int) -> None:
    found = whole(written(tmp_path / "a.gt3x", seconds(VALUES[: 4 * rate], rate), info(rate)), 97)
    exact = [START_US + int(Fraction(k * 10**6, rate) + Fraction(1, 2)) for k in range(4 * rate)]
    assert found.times.tolist() == exact


def test_jumps_of_the_clock_are_breaks(tmp_path: Path) -> None:
    log = seconds(VALUES[:200], 50) + seconds(VALUES[200:400], 50, start_s=START_S + 10)
    log += seconds(VALUES[400:], 50, start_s=START_S + 5)
    found = whole(written(tmp_path / "a.gt3x", log))
    assert (found.counts == VALUES).all()
    assert found.breaks == [200, 400]
    assert found.found == [("clock_gap", 4 * 309, 200, 1), ("clock_back", 8 * 309, 400, 1)]
    assert "6.000 s" in found.problems[0].message
    assert "9.000 s" in found.problems[1].message
    assert found.times[200] == START_US + 10_000_000


def test_a_record_that_repeats_the_one_before_is_left_out(tmp_path: Path) -> None:
    log = seconds(VALUES, 50)
    found = whole(written(tmp_path / "a.gt3x", [*log[:4], log[3], *log[4:], log[-1]]))
    assert (found.counts == VALUES).all()
    assert found.breaks == []
    assert found.found == [("duplicate_record", 4 * 309, 200, 1), ("duplicate_record", 11 * 309, 500, 1)]


def test_two_different_records_of_one_second_are_both_kept(tmp_path: Path) -> None:
    log = seconds(VALUES[:100], 50) + seconds(VALUES[100:], 50, start_s=START_S + 1)
    found = whole(written(tmp_path / "a.gt3x", log))
    assert (found.counts == VALUES).all()
    assert (found.breaks, found.found) == ([100], [("clock_back", 2 * 309, 100, 1)])


@pytest.mark.parametrize(("rows", "breaks"), [(20, [120]), (49, [149]), (51, [151]), (60, [160])])
def test_records_of_another_length_are_kept_and_reported(tmp_path: Path, rows: int, breaks: list) -> None:
    odd = random_counts(rows, 2)
    log = [*seconds(VALUES[:100], 50), activity(START_S + 2, odd)]
    log += seconds(VALUES[150:], 50, start_s=START_S + 3)
    found = whole(written(tmp_path / "a.gt3x", log))
    assert (found.counts == np.concatenate((VALUES[:100], odd, VALUES[150:]))).all()
    assert (found.breaks, found.found) == (breaks, [("record_length", 2 * 309, 100, 1)])
    assert (np.diff(found.times) > 0).all()


def test_settings_come_from_info_txt(tmp_path: Path) -> None:
    text = info(50, "341,5", Acceleration_Min="-6,0", Acceleration_Max=6, Start_Date=0)
    recording = opened(written(tmp_path / "a.gt3x", seconds(VALUES, 50), text)).recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (50, 341.5, 6)
    assert recording.device == Device("wGT3XBT", "TAS1D48140206", "1.9.2")
    assert (recording.start_us, recording.duration_s, recording.timezone) == (START_US, 24, "UTC")


def test_without_info_txt_the_parameters_tell_the_scale(tmp_path: Path) -> None:
    log = [parameters({(1, 10): 50, (0, 55): encoded(341.0)}), *seconds(VALUES, 50)]
    path = tmp_path / "a.gt3x"
    path.write_bytes(zipped({"log.bin": b"".join(log)}))
    recording = opened(path).recording
    assert (recording.rate_hz, recording.lsb_per_g, recording.range_g) == (50, 341, 6)
    assert whole(path).found == [("damaged_header", None, 0, 1)]


@pytest.mark.parametrize(
    ("serial", "scale", "range_g"),
    [("NEO1", 341, 6), ("CLE2", 341, 6), ("MRA1", 341, 6), ("MOS2", 256, 8), ("TAS1", 256, 8)],
)
def test_else_the_serial_number_tells_the_scale(
    tmp_path: Path, serial: str, scale: float, range_g: float
) -> None:
    unsaid = dict.fromkeys(("Acceleration_Scale", "Acceleration_Min", "Acceleration_Max"))
    path = written(tmp_path / "a.gt3x", seconds(VALUES, 50), info(Serial_Number=serial, **unsaid))
    assert (opened(path).recording.lsb_per_g, opened(path).recording.range_g) == (scale, range_g)


def test_what_tells_no_scale_asks_for_it(tmp_path: Path) -> None:
    for text in (info(Serial_Number="XYZ", Acceleration_Scale=None), info(Acceleration_Scale=1)):
        path = written(tmp_path / "a.gt3x", seconds(VALUES, 50), text)
        with pytest.raises(UnreadableError, match="--lsb-per-g"):
            opened(path)
        assert opened(path, lsb_per_g=248.0).recording.lsb_per_g == 248


def test_rates_must_agree(tmp_path: Path) -> None:
    path = written(tmp_path / "a.gt3x", seconds(VALUES, 50))
    with pytest.raises(UsageError, match="50 Hz, not 100"):
        opened(path, rate_hz=100.0)
    assert opened(path, rate_hz=50.1).recording.rate_hz == 50.1
    other = written(tmp_path / "b.gt3x", seconds(VALUES, 100), info(50))
    assert opened(other).recording.rate_hz == 100
    assert opened(other).recording.notes[0].startswith("the header says 50 Hz")


def test_the_clock_is_local_time_unless_the_file_says_utc(tmp_path: Path) -> None:
    log, text = seconds(VALUES, 50), info(TimeZone="-05:00:00")
    local = opened(written(tmp_path / "a.gt3x", log, text)).recording
    assert (local.timezone, local.start_us, local.notes) == ("-05:00", START_US, ())
    said = record(METADATA, START_S, b'{"UsedUtc":true,"UtcOffset":"-05:00","MetadataType":"LocalTimeLog"}')
    utc = opened(written(tmp_path / "b.gt3x", [said, *log], text)).recording
    assert (utc.timezone, utc.start_us, utc.notes) == ("UTC", START_US, ())
    deep = record(METADATA, START_S, b"[" * 60_000)
    assert opened(written(tmp_path / "c.gt3x", [deep, *log], text)).recording.timezone == "-05:00"


def test_the_axes_that_firmware_1_6_0_exchanged_are_put_back(tmp_path: Path) -> None:
    text = info(Serial_Number="MOS2A", Firmware="1.6.0")
    path = written(tmp_path / "a.gt3x", seconds(VALUES, 50, ACTIVITY), text)
    assert (whole(path).counts == np.stack((VALUES[:, 1], -VALUES[:, 0], VALUES[:, 2]), axis=1)).all()
    assert "1.6.0" in opened(path).recording.notes[0]


@pytest.mark.parametrize("name", ["a.gt3x", "A.GT3X", "a.zip", "a"])
def test_it_is_recognised_by_what_is_in_it(tmp_path: Path, name: str) -> None:
    log = {"epoch.bin": bytes(80_000), "log.bin": b"".join(seconds(VALUES, 50)), "info.txt": info()}
    path = tmp_path / name
    path.write_bytes(zipped(log, 0))
    assert find_format(path, ReadOptions()).name == "gt3x"
    path.write_bytes(bytes(4) + zipped(log, 0)[4:])
    assert sniff(probe_file(path, ReadOptions())) == (100 if name.lower().endswith(".gt3x") else 0)


def test_other_zip_files_are_not(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    path.write_bytes(zipped({"sheet.xml": b"1,2,3\n" * 100}))
    assert sniff(probe_file(path, ReadOptions())) == 0
    named = path.rename(tmp_path / "a.gt3x")
    with pytest.raises(UnreadableError, match=r"holds neither log\.bin nor activity\.bin"):
        open_recording(named, ReadOptions())


def test_a_second_gzip_around_it_is_refused_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.gt3x.gz"
    path.write_bytes(gzip.compress(zipped({"log.bin": b"".join(seconds(VALUES, 50)), "info.txt": info()})))
    with pytest.raises(UnreadableError, match=r"gunzip -k"):
        open_recording(path, ReadOptions())


@pytest.mark.parametrize("scale", ["1e200", "1e10", "-256", "nan"])
def test_an_impossible_scale_counts_as_missing(tmp_path: Path, scale: str) -> None:
    text = info(50).replace("Acceleration Scale: 256.0", f"Acceleration Scale: {scale}")
    path = written(tmp_path / "a.gt3x", seconds(random_counts(150), 50), text)
    assert opened(path).recording.lsb_per_g == 256.0
    with pytest.raises(UnreadableError, match="does not say how many counts are one g"):
        opened(written(path, seconds(random_counts(150), 50), text.replace("TAS", "XYZ")))


def test_an_impossible_range_counts_as_missing(tmp_path: Path) -> None:
    text = info(50).replace("-8.0", "-1e200").replace("8.0", "1e200")
    path = written(tmp_path / "a.gt3x", seconds(random_counts(150), 50), text)
    assert opened(path).recording.range_g == 8.0


@pytest.mark.parametrize("name", ["a.agdc", "a.gt3x"])
def test_t12_times_of_centrepoint_are_utc(tmp_path: Path, name: str) -> None:
    """A file of ActiLife has no info.json, and its times are those of the zone that it states."""
    text = info(50, TimeZone="-05:00:00")
    beside = {} if name.endswith(".agdc") else {"info": {"startDate": START_S}}
    recording = opened(written(tmp_path / name, seconds(random_counts(100), 50), text, **beside)).recording
    assert (recording.timezone, recording.start_us) == ("UTC", START_US)
    assert any("-R worn_zone=-05:00" in note for note in recording.notes)
    local = opened(written(tmp_path / "b.gt3x", seconds(random_counts(100), 50), text)).recording
    assert (local.timezone, local.notes) == ("-05:00", ())


def test_t12_the_centrepoint_recording_of_the_cases(real_data: Path) -> None:
    recording = opened(real_data / "cases" / "centrepoint_utc.agdc").recording
    assert iso_time(recording.start_us, 0) == "2022-08-18T16:18:00.000000+00:00"
    assert recording.timezone == "UTC"


@pytest.mark.parametrize(
    ("text", "zone"),
    [("-5", "-05:00"), ("+5:30", "+05:30"), ("00:00:00", "UTC"), ("Mars", None), ("+77", None)],
)
def test_t11_a_zone_is_used_or_noted(tmp_path: Path, text: str, zone: str | None) -> None:
    path = written(tmp_path / "a.gt3x", seconds(random_counts(100), 50), info(50, TimeZone=text))
    recording = opened(path).recording
    assert recording.timezone == zone
    assert len([note for note in recording.notes if f"time zone {text!r} of the header" in note]) == (
        zone is None
    )

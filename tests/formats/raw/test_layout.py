"""Layout files: every key of the contract, and an error with file and key for what cannot be."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from accelcal_cli.core.clock import StartTime
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats.raw import FORMAT, find_layout, named_layout
from accelcal_cli.formats.raw.layout import Field, load_layout

FULL = """
[dump]
rate_hz = 100.0
lsb_per_g = 256.0
range_g = 8.0
start_time = "2024-03-04T00:00:00"
serial = "012345"
model = "M"
firmware = "1.2"
endian = "big"
header_bytes = 64
page_bytes = 512
page_header_bytes = 16
page_trailer_bytes = 4
frame_bytes = 20
[fields]
x = { offset = 0, type = "int16" }
y = { offset = 2, type = "int16" }
z = { offset = 4, type = "int16", zero = 2 }
temperature = { offset = 6, type = "int16", per_unit = 0.0078125, zero = 25.0 }
gx = { offset = 8, type = "int16", per_unit = 0.061 }
gy = { offset = 10, type = "int16", per_unit = 0.061 }
gz = { offset = 12, type = "int16", per_unit = 0.061 }
[page]
sequence = { offset = 0, type = "uint32" }
time = { offset = 4, type = "uint32", per_unit = 0.5 }
crc = { offset = 508, type = "crc32", covers = [0, 508] }
"""
SMALL = """
[dump]
rate_hz = 50
lsb_per_g = 1000
[fields]
x = { offset = 0, type = "int24" }
y = { offset = 3, type = "int24" }
z = { offset = 6, type = "int24" }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "a.layout.toml"
    path.write_text(text)
    return path


def test_every_key_is_read(tmp_path: Path) -> None:
    layout = load_layout(written(tmp_path, FULL))
    assert (layout.rate_hz, layout.lsb_per_g, layout.range_g) == (100.0, 256.0, 8.0)
    assert (layout.serial, layout.model, layout.firmware, layout.endian) == ("012345", "M", "1.2", "big")
    assert layout.start == StartTime(1_709_510_400_000_000, None)
    assert (layout.header_bytes, layout.page_bytes, layout.frame_bytes) == (64, 512, 20)
    assert (layout.page_header_bytes, layout.page_trailer_bytes, layout.page_frames) == (16, 4, 24)
    assert layout.fields["z"] == Field(4, "int16", None, 2.0)
    assert layout.fields["temperature"] == Field(6, "int16", 0.0078125, 25.0)
    assert layout.page == {
        "sequence": Field(0, "uint32"),
        "time": Field(4, "uint32", 0.5),
        "crc": Field(508, "crc32", covers=(0, 508)),
    }


def test_all_but_rate_scale_and_fields_is_optional(tmp_path: Path) -> None:
    layout = load_layout(written(tmp_path, SMALL))
    assert (layout.frame_bytes, layout.page_bytes, layout.header_bytes, layout.endian) == (9, 0, 0, "little")
    assert (layout.range_g, layout.start, layout.serial, layout.page) == (None, None, None, {})


@pytest.mark.parametrize(
    ("value", "start_us", "zone"),
    [
        ('"1970-01-02 00:00:00.5"', 86_400_500_000, None),
        ("1970-01-02T00:00:00", 86_400_000_000, None),
        ('"1970-01-02T01:00:00+01:00"', 86_400_000_000, "UTC"),
        ("1970-01-02T00:00:00Z", 86_400_000_000, "UTC"),
    ],
)
def test_start_time_forms(tmp_path: Path, value: str, start_us: int, zone: str | None) -> None:
    text = FULL.replace('"2024-03-04T00:00:00"', value)
    assert load_layout(written(tmp_path, text)).start == StartTime(start_us, zone, "+01:00" in value)


FIELD_X = 'x = { offset = 0, type = "int16" }'
FIELD_GY = 'gy = { offset = 10, type = "int16", per_unit = 0.061 }'
SEQUENCE = 'sequence = { offset = 0, type = "uint32" }'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rate_hz = 100.0", "", "dump.rate_hz is missing"),
        ("rate_hz = 100.0", "rate_hz = 0", "dump.rate_hz is 0"),
        ("rate_hz = 100.0", "rate_hz = nan", "dump.rate_hz must be a number"),
        ("rate_hz = 100.0", "rate_hz = true", "dump.rate_hz must be a number"),
        ("lsb_per_g = 256.0", 'lsb_per_g = "256"', "dump.lsb_per_g must be a number"),
        ("lsb_per_g = 256.0", "lsb_per_g = -1", "dump.lsb_per_g is -1"),
        ("range_g = 8.0", "range = 8.0", "dump.range is not a known key; did you mean 'range_g'"),
        ("range_g = 8.0", "range_g = 0", "dump.range_g is 0"),
        ('"2024-03-04T00:00:00"', '"yesterday"', "dump.start_time is 'yesterday'"),
        ('"2024-03-04T00:00:00"', "12", "dump.start_time is 12"),
        ('"2024-03-04T00:00:00"', "2024-03-04", "dump.start_time is 2024-03-04"),
        ('serial = "012345"', "serial = 12345", "dump.serial must be text in quotes"),
        ('endian = "big"', 'endian = "middle"', "allowed: little, big"),
        ("header_bytes = 64", "header_bytes = -1", "dump.header_bytes is -1"),
        ("header_bytes = 64", "header_bytes = 1.5", "dump.header_bytes must be a whole number"),
        ("header_bytes = 64", f"header_bytes = {1 << 62}", "dump.header_bytes is"),
        ("page_bytes = 512", "", "page_bytes is missing, but a page header"),
        ("page_bytes = 512", "page_bytes = 0", "dump.page_bytes is 0"),
        ("page_bytes = 512", "page_bytes = 39", "dump.page_bytes is 39, but header, trailer and one frame"),
        ("page_bytes = 512", "page_bytes = 511", "page.crc ends at byte 512"),
        ("page_bytes = 512", f"page_bytes = {1 << 30}", "dump.page_bytes is"),
        ("page_header_bytes = 16", "page_header_bytes = 7", "page.time and the frames"),
        ("page_trailer_bytes = 4", "page_trailer_bytes = 0", None),
        ("frame_bytes = 20", "frame_bytes = 13", "fields.gz ends at byte 14"),
        ("frame_bytes = 20", "frame_bytes = 0", "dump.frame_bytes is 0"),
        ("frame_bytes = 20", "frame_bytes = 70000\npage_bytes2 = 1", "not a known key"),
        ("y = { offset = 2", "y = { offset = 1", "fields.x and fields.y overlap at byte 1"),
        ("y = { offset = 2", "Y = { offset = 2", "fields.Y is not a known key"),
        (FIELD_X, "", "fields.x is missing"),
        (FIELD_X, "x = 3", "fields.x must be a table"),
        (FIELD_X, 'x = { type = "int16" }', "fields.x.offset is missing"),
        (FIELD_X, "x = { offset = 0 }", "fields.x.type is missing"),
        (FIELD_X, 'x = { offset = 0, type = "int64" }', "fields.x.type is 'int64'"),
        ("zero = 2 }", "zero = 2.5 }", "fields.z.zero must be a whole number"),
        ("zero = 2 }", "per_unit = 2.5 }", "fields.z.per_unit cannot be used for x, y and z"),
        ("zero = 25.0 }", "zeros = 25.0 }", "did you mean 'zero'"),
        (FIELD_GY, "", "fields.gx needs all of gx, gy, gz"),
        (FIELD_GY, FIELD_GY.replace("0.061", "0"), "fields.gy.per_unit must be at least"),
        (SEQUENCE, SEQUENCE.replace("uint32", "int16"), "page.sequence.type is 'int16'"),
        (SEQUENCE, SEQUENCE.replace("0", "2"), "page.sequence and page.time overlap"),
        ("per_unit = 0.5", "per_unit = 0", "page.time.per_unit is 0"),
        ("covers = [0, 508]", "covers = [0, 512]", "page.crc.covers includes the checksum itself"),
        ("covers = [0, 508]", "covers = [0, 600]", "page.crc.covers ends at 600"),
        ("covers = [0, 508]", "covers = [8, 8]", "page.crc.covers must be two byte numbers"),
        ("covers = [0, 508]", "covers = 508", "page.crc.covers must be two byte numbers"),
        ("covers = [0, 508]", "cover = [0, 508]", "page.crc.covers is missing"),
        ('type = "crc32"', 'type = "md5"', "allowed: crc32, crc16-ccitt"),
        ("[page]", "[pages]", "[pages] is not a known key; did you mean 'page'"),
        ("[fields]", "[field]", "[field] is not a known key; did you mean 'fields'?"),
        ("[dump]", "[dump", "line 2"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named(tmp_path: Path, old: str, new: str, said: str | None) -> None:
    assert old in FULL
    path = written(tmp_path, FULL.replace(old, new))
    if said is None:
        load_layout(path)
        return
    with pytest.raises(UsageError) as raised:
        load_layout(path)
    assert said in str(raised.value)
    assert str(path) in str(raised.value)


def test_page_keys_without_pages_are_refused(tmp_path: Path) -> None:
    text = SMALL + '[page]\nsequence = { offset = 0, type = "uint8" }\n'
    with pytest.raises(UsageError, match="page_bytes is missing, but \\[page\\]"):
        load_layout(written(tmp_path, text))


def test_an_unreadable_layout_is_a_usage_error(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    with pytest.raises(UsageError, match="cannot be read"):
        load_layout(path)
    path.write_bytes(b"[dump]\nserial = '\xff'\n")
    with pytest.raises(UsageError, match=r"byte 17.*not UTF-8"):
        load_layout(path)


def test_the_named_layout_goes_before_the_dumps_own_before_the_folders(tmp_path: Path) -> None:
    dump, said = tmp_path / "night.1.bin.gz", tmp_path / "said.toml"
    assert find_layout(dump, ReadOptions()) is None
    (tmp_path / "layout.toml").touch()
    assert find_layout(dump, ReadOptions()) == tmp_path / "layout.toml"
    own = tmp_path / "night.1.layout.toml"
    own.touch()
    assert find_layout(dump, ReadOptions()) == own == named_layout(tmp_path / "night.1.raw")
    assert find_layout(dump, ReadOptions(layout=said)) == said


def test_the_layouts_of_the_documentation_are_valid(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs" / "layout-files.md").read_text(encoding="utf-8")
    examples = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    assert len(examples) == 2
    for example in examples:
        load_layout(written(tmp_path, example))


def inspected(layout: Path, megabytes: int) -> subprocess.CompletedProcess[str]:
    """A layout read by a process that is given no more memory and time than that."""
    bounds = f"setrlimit(RLIMIT_AS, ({megabytes} << 20,) * 2); setrlimit(RLIMIT_CPU, (20,) * 2)"
    code = (
        f"from resource import *\n{bounds}\nimport sys\nfrom pathlib import Path\n"
        "from accelcal_cli.core.errors import UsageError\n"
        "from accelcal_cli.formats.raw.layout import load_layout\n"
        "try: load_layout(Path(sys.argv[1]))\nexcept UsageError as error: print(error)\n"
    )
    return subprocess.run(
        [sys.executable, "-c", code, str(layout)], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a=" + "[" * 900, "nested too deep"),
        pytest.param("a=[" + "\n[" * 5000, "nested too deep", marks=pytest.mark.nightly),
        ("a=" + "1" * 5000, "line 1: the layout has a line of more than 1000 characters"),
        pytest.param(
            "#\na" + ".a" * 20_000 + "=1",
            "line 2: the layout has a line of more than 1000 characters",
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            "a" + ".a" * 490 + "=1\n",
            "[a] is not a known key; valid keys: dump, fields, page",
            marks=pytest.mark.nightly,
        ),
        ("#\n" * 40_000, "the layout is too large, more than 65536 bytes"),
    ],
)
def test_a_layout_made_to_do_harm_is_refused_in_bounded_memory(tmp_path: Path, text: str, words: str) -> None:
    ran = inspected(written(tmp_path, text), 256)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert words in ran.stdout


def test_a_layout_without_an_end_is_refused() -> None:
    assert "more than 65536 bytes" in inspected(Path("/dev/zero"), 256).stdout


def test_a_long_value_is_shown_in_short(tmp_path: Path) -> None:
    text = SMALL.replace("rate_hz = 50", "rate_hz = " + "[" * 80 + "]" * 80)
    with pytest.raises(UsageError, match="rate_hz must be a number") as caught:
        load_layout(written(tmp_path, text))
    assert len(str(caught.value)) < len(str(tmp_path)) + 120


def test_no_layout_has_more_counts_per_g_than_the_option_takes(tmp_path: Path) -> None:
    assert load_layout(written(tmp_path, SMALL.replace("1000", "1e9"))).lsb_per_g == 1e9
    with pytest.raises(UsageError, match=r"lsb_per_g is 1000000000000.0, which is not between"):
        load_layout(written(tmp_path, SMALL.replace("1000", "1e12")))


@pytest.mark.parametrize("start", ["0001-01-01T00:00:00+01:00", "9999-12-31T23:59:59-01:00"])
def test_a_start_outside_the_years_1_to_9999_is_refused(tmp_path: Path, start: str) -> None:
    text = SMALL.replace("[fields]", f'start_time = "{start}"\n[fields]')
    with pytest.raises(UsageError, match=r"start_time is .*, which in UTC lies outside the years 1 to 9999"):
        load_layout(written(tmp_path, text))
    inside = start[:19] + "+00:00"
    assert load_layout(written(tmp_path, text.replace(start, inside))).start is not None


@pytest.mark.parametrize(("size", "refused"), [(1 << 16, False), ((1 << 16) + 1, True)])
def test_a_crc16_covers_no_more_than_it_can_be_made_for(tmp_path: Path, size: int, refused: bool) -> None:
    """It takes a step and half a kilobyte of tables for each byte of a page: 8 GB for the largest one."""
    text = f"""[dump]
rate_hz = 100.0
lsb_per_g = 256.0
page_bytes = {size + 2}
page_trailer_bytes = 2
[fields]
x = {{ offset = 0, type = "int16" }}
y = {{ offset = 2, type = "int16" }}
z = {{ offset = 4, type = "int16" }}
[page]
crc = {{ offset = {size}, type = "crc16-ccitt", covers = [0, {size}] }}
"""
    path = tmp_path / "a.layout.toml"
    path.write_text(text)
    if not refused:
        assert "crc" in load_layout(path).page
        return
    with pytest.raises(UsageError, match=r"page.crc.covers is 65537 bytes, crc16-ccitt at most 65536"):
        load_layout(path)
    path.write_text(
        text.replace("crc16-ccitt", "crc32")
        .replace("page_trailer_bytes = 2", "page_trailer_bytes = 4")
        .replace(f"page_bytes = {size + 2}", f"page_bytes = {size + 4}")
    )
    assert "crc" in load_layout(path).page


@pytest.mark.parametrize("name", ["night.dmp", "night", "night.001.gz"])
def test_a_layout_of_its_own_lies_beside_a_file_of_any_suffix(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(bytes(range(250)) * 10)
    assert FORMAT.sniff(probe_file(path, ReadOptions())) == 0
    (tmp_path / named_layout(path).name).touch()
    assert FORMAT.sniff(probe_file(path, ReadOptions())) == 35
    (tmp_path / f"{Path(name.removesuffix('.gz')).stem}.bin").touch()
    assert FORMAT.sniff(probe_file(path, ReadOptions())) == 0

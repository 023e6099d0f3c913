"""Files made to do harm: read in bounded memory, with few open files, and nothing else is opened for them."""

from __future__ import annotations

import gzip
import json
import os
import sys
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.cli.run import Ran, assert_one_line, nightly
from tests.faults.shim import Runner
from tests.recordings import directions, still_counts, write_csv

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs limits of address space")
Limited = Callable[..., Ran]

MEGABYTE = 1 << 20
BLOCK = 16 * MEGABYTE
HEAD = b"time,x,y,z\n"
LAYOUT = "[dump]\nrate_hz = 25\nlsb_per_g = 256\nrange_g = 8.0\n[fields]\n" + "".join(
    f"{axis} = {{ offset = {2 * index}, type = 'int16' }}\n" for index, axis in enumerate("xyz")
)


@pytest.fixture
def limited(forks: Runner, tmp_path: Path) -> Limited:
    """Run a command with little memory and few open files; temporary files go into the folder."""
    (tmp_path / "tmp").mkdir()
    return lambda *words: forks.run([*map(str, words)], tmp_path, limit_s=900).ran


def packed(path: Path, block: bytes, times: int, head: bytes = b"") -> Path:
    """A gzip file of a block that is repeated; it is packed once."""
    one = gzip.compress(block)
    with path.open("wb") as file:
        file.write(gzip.compress(head))
        file.writelines(one for _ in range(times))
    return path


def size(small: int, large: int) -> list[object]:
    """Blocks: few in `make test`, many in `make nightly`."""
    return [small, nightly(large)]


@pytest.mark.parametrize("blocks", size(8, 640))
@pytest.mark.parametrize("suffix", [".csv.gz", nightly(".cwa.gz"), nightly(".gt3x.gz")])
def test_endless_zeros_are_no_recording(limited: Limited, tmp_path: Path, blocks: int, suffix: str) -> None:
    path = packed(tmp_path / f"zeros{suffix}", bytes(BLOCK), blocks)
    assert_one_line(limited("calibrate", path, "-q"), str(path), code=3)


@pytest.mark.parametrize("blocks", size(2, 64))
def test_zeros_with_a_layout_are_refused(limited: Limited, tmp_path: Path, blocks: int) -> None:
    path = packed(tmp_path / "zeros.raw.gz", bytes(BLOCK), blocks)
    (tmp_path / "zeros.layout.toml").write_text(LAYOUT)
    ran = limited("calibrate", path, "-q")
    assert_one_line(ran, "refused", "cut short", "Copy it again", code=4)
    assert ran.err.lower().count("again from the device") == 1


@pytest.mark.parametrize("blocks", size(8, 64))
@pytest.mark.parametrize(
    ("head", "block"),
    [
        (HEAD + b"2024-03-04T00:00:00,0.1,0.2,", b"1"),
        nightly(b"time,x,y,z", b","),
        nightly(HEAD + b'"', b'"a\n"'),
    ],
    ids=["a cell", "columns", "quotes"],
)
def test_an_endless_line(limited: Limited, tmp_path: Path, head: bytes, block: bytes, blocks: int) -> None:
    path = packed(tmp_path / "line.csv.gz", block * (BLOCK // len(block)), blocks, head)
    assert_one_line(limited("calibrate", path, "-q"), str(path), code=3)


@pytest.mark.parametrize("blocks", size(8, 64))
def test_a_line_without_end_after_good_ones(limited: Limited, tmp_path: Path, blocks: int) -> None:
    good = write_csv(tmp_path / "good.csv", still_counts(directions(3))).read_bytes()
    path = packed(tmp_path / "line.csv.gz", b"1" * BLOCK, blocks, good)
    assert_one_line(limited("calibrate", path, "-q"), str(path), "a line has no end", code=3)


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """Whoever opens it waits without end."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    return path


def external_link(file: h5py.File, pipe: Path) -> None:
    file["accel"] = h5py.ExternalLink(str(pipe), "/accel")


def external_values(file: h5py.File, pipe: Path) -> None:
    file.create_dataset("accel", (3000, 3), "<i2", external=[(str(pipe), 0, 18000)])


def virtual(file: h5py.File, pipe: Path) -> None:
    layout = h5py.VirtualLayout((3000, 3), "<i2")
    layout[:] = h5py.VirtualSource(str(pipe), "accel", (3000, 3))
    file.create_virtual_dataset("accel", layout)


def claims_much(file: h5py.File, _pipe: Path) -> None:
    file.create_dataset("accel", (2**40, 3), "<i2", chunks=(1024, 3), compression="gzip")


def one_chunk(file: h5py.File, _pipe: Path) -> None:
    values = file.create_dataset("accel", (2**28, 3), "<i2", chunks=(2**28, 3), compression="gzip")
    values.id.write_direct_chunk((0, 0), gzip.zlib.compress(bytes(BLOCK)))


def very_wide(file: h5py.File, _pipe: Path) -> None:
    file.create_dataset("accel", (1000, 2**26), "<i2", chunks=(1, 2**20), compression="gzip")


def endless(file: h5py.File, _pipe: Path) -> None:
    group = file.create_group("a")
    group["again"], group["root"] = group, file["/"]
    file["accel"] = h5py.SoftLink("/accel")


@pytest.mark.parametrize(
    "make",
    [*(external_link, endless), *map(nightly, (one_chunk, external_values, virtual, claims_much, very_wide))],
)
def test_hdf5_opens_no_other_file_and_takes_no_memory_for_claims(
    limited: Limited, tmp_path: Path, pipe: Path, make: Callable[[h5py.File, Path], None]
) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        make(file, pipe)
        file.attrs["sample_rate"] = 25.0
    ran = limited("calibrate", path, "-q", "--unit", "counts", "--lsb-per-g", 256)
    assert ran.code in (2, 3)
    assert_one_line(ran, str(path))


@pytest.mark.parametrize(
    "words",
    [
        ("report", "{}"),
        nightly(("export", "{}", "--to", "ggir")),
        nightly(("apply", "x.csv", "--coefficients", "{}")),
    ],
    ids=["report", "export", "apply"],
)
@pytest.mark.parametrize(
    ("head", "more", "times"), [("", '{"a":', 200_000), ('{"a":[', "1,", 40_000_000)], ids=["deep", "long"]
)
def test_json_that_is_deep_or_long(
    limited: Limited, tmp_path: Path, words: tuple[str, ...], head: str, more: str, times: int
) -> None:
    path = tmp_path / "a.calibration.json"
    path.write_text(head + more * times + "1")
    write_csv(tmp_path / "x.csv", still_counts(directions(2)))
    ran = limited(*(word.format(path).replace("x.csv", f"{tmp_path}/x.csv") for word in words))
    assert_one_line(ran, str(path), code=3)


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[\n" * 10_000,
        nightly("a = " + "{ b = " * 150),
        nightly("[" + "a." * 400 + "a]\n"),
        "a = 1\n" * 20_000,
    ],
)
def test_toml_that_is_deep_or_long(limited: Limited, tmp_path: Path, text: str) -> None:
    (tmp_path / "a.raw").write_bytes(bytes(6000))
    layout = tmp_path / "a.layout.toml"
    layout.write_text(text)
    assert_one_line(limited("calibrate", tmp_path / "a.raw", "-q"), str(layout), code=2)


def tar_of_zeros(path: Path, kind: bytes, blocks: int) -> Path:
    """A packed member, or header, of as many bytes as it claims."""
    header = tarfile.TarInfo("a.csv")
    header.type, header.size = kind, blocks * BLOCK
    return packed(path, bytes(BLOCK), blocks, header.tobuf())


@pytest.mark.parametrize("blocks", [nightly(256)])
@pytest.mark.parametrize("kind", [tarfile.REGTYPE, tarfile.XHDTYPE], ids=["member", "header"])
def test_archives_of_gigabytes(limited: Limited, tmp_path: Path, kind: bytes, blocks: int) -> None:
    path = tar_of_zeros(tmp_path / "a.tar.gz", kind, blocks)
    assert_one_line(limited("calibrate", path, "-q"), str(path), code=3)
    assert not [*(tmp_path / "tmp").iterdir()]


@pytest.mark.parametrize("blocks", size(4, 128))
@pytest.mark.parametrize("name", ["log.bin", nightly("info.txt")])
def test_a_gt3x_file_of_gigabytes(limited: Limited, tmp_path: Path, name: str, blocks: int) -> None:
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for member in {"log.bin", "info.txt"} - {name}:
            archive.writestr(member, "Serial Number: NEO1\nSample Rate: 30\n")
        with archive.open(name, "w", force_zip64=True) as file:
            for _ in range(blocks):
                file.write(bytes(BLOCK))
    assert_one_line(limited("calibrate", path, "-q"), str(path), code=3)


def parts(folder: Path, number: int) -> Iterator[Path]:
    """Tables of half a minute each."""
    counts = still_counts(directions(number))
    lines = write_csv(folder / "whole.csv", counts).read_text().splitlines(keepends=True)
    (folder / "whole.csv").unlink()
    rows = (len(lines) - 1) // number
    for index in range(number):
        path = folder / f"{index:03d}.csv"
        path.write_text(lines[0] + "".join(lines[1 + index * rows : 1 + (index + 1) * rows]))
        yield path


def test_more_parts_than_files_may_be_open(limited: Limited, tmp_path: Path) -> None:
    folder = tmp_path / "S01"
    folder.mkdir()
    assert len(list(parts(folder, 80))) == 80
    ran = limited("calibrate", "--parts", folder, "-d", tmp_path / "out", "-q")
    assert ran.code == 0, ran.err
    report = json.loads((tmp_path / "out" / "S01.calibration.json").read_text())
    assert "80 parts" in " ".join(report["recording"]["notes"])
    assert np.isclose(report["calibration"]["offset_g"], [0.03, -0.02, 0.045], atol=0.002).all()

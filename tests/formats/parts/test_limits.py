"""Archives that unpack to more than any recording has, disks without room for them, and threads."""

from __future__ import annotations

import errno
import gzip
import io
import os
import random
import tarfile
import tempfile
import zipfile
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest

from accelcal_cli.core.errors import OutputError, UnreadableError
from accelcal_cli.formats._parts import archive
from accelcal_cli.formats._parts.archive import first_names, unpack

MEGABYTE = 1 << 20
Disk = namedtuple("Disk", "total used free")


def tar_bomb(path: Path) -> Path:
    """16 MB of zeros in some 16 KB; half of them in a member that is not wanted."""
    with gzip.open(path.with_suffix(".tar.gz"), "wb") as file:
        for name in ("a.csv", "b.log.csv"):
            header = tarfile.TarInfo(name)
            header.size = 8 * MEGABYTE
            file.write(header.tobuf() + bytes(header.size))
        file.write(bytes(1024))
    return path.with_suffix(".tar.gz")


def zip_bomb(path: Path) -> Path:
    """As many zeros in a zip file."""
    with zipfile.ZipFile(path.with_suffix(".zip"), "w", zipfile.ZIP_DEFLATED) as made:
        for name in ("a.csv", "b.csv"):
            made.writestr(name, bytes(8 * MEGABYTE))
    return path.with_suffix(".zip")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits that bombs of some kilobytes exceed."""
    monkeypatch.setattr(archive, "MOST_BYTES", MEGABYTE)


@pytest.mark.parametrize("bomb", [tar_bomb, zip_bomb])
def test_what_unpacks_to_far_more_than_its_size_is_refused(
    tmp_path: Path, small: None, bomb: Callable[[Path], Path]
) -> None:
    path, folder = bomb(tmp_path / "bomb"), tmp_path / "unpacked"
    folder.mkdir()
    with pytest.raises(UnreadableError, match=f"{path.name}: unpacks to more than 250 times its size"):
        unpack(path, folder, lambda _name: True)
    written = sum(one.stat().st_size for one in folder.rglob("*") if one.is_file())
    assert written <= MEGABYTE + 250 * path.stat().st_size


def test_members_that_are_passed_over_count_too(tmp_path: Path, small: None) -> None:
    path = tar_bomb(tmp_path / "bomb")
    with pytest.raises(UnreadableError, match="unpacks to more than"):
        unpack(path, tmp_path, lambda _name: False)
    assert list(first_names(path, 5)) == ["a.csv"]


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (8, 1, "a.zip: is encrypted; unpack it with its password, and give a.csv"),
        (10, 12, "a.zip: a.csv in it is packed with bzip2, which is not unpacked"),
        (10, 14, "a.zip: a.csv in it is packed with LZMA, which is not unpacked"),
        (10, 97, "a.zip: a.csv in it is packed with method 97, which is not unpacked"),
    ],
)
def test_h17_a_zip_file_that_cannot_be_unpacked_says_why(
    tmp_path: Path, place: int, value: int, words: str
) -> None:
    """By flags and method of a member, as its entry in the directory has them."""
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as made:
        made.writestr("a.csv", "1,2,3\n")
    data = bytearray((tmp_path / "a.zip").read_bytes())
    data[data.index(b"PK\x01\x02") + place] = value
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(UnreadableError, match=words):
        unpack(tmp_path / "a.zip", tmp_path, lambda _name: True)


@pytest.mark.parametrize("suffix", [".tar.gz", ".tar", ".zip"])
def test_a_thread_that_unpacks_ahead_changes_nothing(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of an archive that is cut short, or damaged, anywhere."""
    monkeypatch.setattr(archive, "COPIED_BYTES", 100)
    texts = {"a.csv": b"1,2,3\n" * 120, "b.csv": b"", "c.csv": random.Random(1).randbytes(500)}
    path = tmp_path / f"a{suffix}"
    if suffix == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
            for name, text in texts.items():
                made.writestr(name, text)
    else:
        with tarfile.open(path, "w:gz" if suffix == ".tar.gz" else "w") as packed:
            for name, text in texts.items():
                header = tarfile.TarInfo(name)
                header.size = len(text)
                packed.addfile(header, io.BytesIO(text))
    data = path.read_bytes()
    step = len(data) // 40
    for place in range(0, len(data), step):
        path.write_bytes(data[:place] + bytes([data[place] ^ 16]) + data[place + 1 :])
        assert unpacked(path, 2) == unpacked(path, 1)
        path.write_bytes(data[: place + 1])
        assert unpacked(path, 2) == unpacked(path, 1)
    path.write_bytes(data)
    assert unpacked(path, 2)[0] == [*texts.items()]


def unpacked(path: Path, threads: int) -> tuple[object, ...]:
    """Names and bytes of what an archive holds, and what is wrong with it, or its error."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        try:
            found = unpack(path, Path(folder), lambda _name: True, threads)
        except UnreadableError as error:
            return (str(error), sorted(one.name for one in Path(folder).rglob("*")))
        return [(one.name, one.read_bytes()) for one in found.files], found.damage, found.lost_bytes


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME])
def test_a_header_that_claims_to_be_long_is_not_read(tmp_path: Path, kind: bytes) -> None:
    header = tarfile.TarInfo("a")
    header.type, header.size = kind, 1 << 32
    path = tmp_path / "a.tar"
    path.write_bytes(header.tobuf() + bytes(10240))
    with pytest.raises(UnreadableError, match="a header claims 4294967296 bytes"):
        unpack(path, tmp_path, lambda _name: True)


def test_an_archive_of_too_many_members_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "MOST_MEMBERS", 3)
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as made:
        for number in range(4):
            made.writestr(f"{number}.csv", "x")
    with pytest.raises(UnreadableError, match="has more than 3 members"):
        unpack(path, tmp_path, lambda _name: True)


@pytest.mark.parametrize("suffix", [".tar", ".zip"])
def test_a_member_without_bytes_is_a_file_without_bytes(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".tar":
        with tarfile.open(path, "w") as made:
            made.addfile(tarfile.TarInfo("empty.csv"))
    else:
        with zipfile.ZipFile(path, "w") as packed:
            packed.writestr("empty.csv", "")
    (found,) = unpack(path, tmp_path, lambda _name: True).files
    assert (found.name, found.read_bytes()) == ("empty.csv", b"")


def test_a_zip_directory_that_is_too_long_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = zip_bomb(tmp_path / "a")
    monkeypatch.setattr(archive, "LARGEST_DIRECTORY", 64)
    with pytest.raises(UnreadableError, match="the directory is too long"):
        unpack(path, tmp_path, lambda _name: True)


def test_a_part_of_the_disk_stays_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive.shutil, "disk_usage", lambda _folder: Disk(1000, 960, 40))
    with pytest.raises(OutputError, match=r"less than 5% of the disk would be left.*set TMPDIR"):
        unpack(zip_bomb(tmp_path / "a"), tmp_path, lambda _name: True)


def test_a_disk_that_fails_is_no_damage_of_the_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The parts before would have been taken for the whole."""
    plain = Path.mkdir

    def second_fails(path: Path, **words: bool) -> None:
        if path.name == "000001":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        plain(path, **words)

    folder = Path(tempfile.mkdtemp(dir=tmp_path))
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as made:
        for name in ("one/a.csv", "two/a.csv"):
            made.writestr(name, "1,2,3\n")
    monkeypatch.setattr(Path, "mkdir", second_fails)
    with pytest.raises(OutputError, match=r"cannot be unpacked .No space left on device"):
        unpack(tmp_path / "a.zip", folder, lambda _name: True)


def test_an_archive_that_the_disk_does_not_give_is_not_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(self: object, most: int) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    path = zip_bomb(tmp_path / "a")
    monkeypatch.setattr(archive.Inflater, "take", fails)
    with pytest.raises(UnreadableError, match=r"cannot be read .Input/output error"):
        unpack(path, tmp_path, lambda _name: True)


def test_h2_a_name_without_end_is_not_shown_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w", format=tarfile.GNU_FORMAT) as made:
        header = tarfile.TarInfo("x" * 900_000 + ".csv")
        header.type = tarfile.GNUTYPE_SPARSE
        made.addfile(header)
    with pytest.raises(UnreadableError, match=r"xxx\.csv in it is a sparse file") as refusal:
        unpack(path, tmp_path, lambda _name: True)
    assert len(refusal.value.message) < 300

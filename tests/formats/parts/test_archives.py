"""Archives: around one recording, around several, hostile ones, and what a cut one still gives."""

from __future__ import annotations

import bz2
import io
import lzma
import shutil
import tarfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core import unpacking
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.core.recording import joined
from accelcal_cli.formats import all_formats, open_recording
from accelcal_cli.formats._parts import archive
from accelcal_cli.formats._parts.archive import first_names, unpack
from tests.cli.run import run
from tests.cli.studies import rows, study
from tests.formats import make_cwa, make_gt3x
from tests.formats.make_unisens import description, folder, signal
from tests.recordings import directions, still_counts, write_csv

Capture = pytest.CaptureFixture[str]
OPTIONS = ReadOptions()
COUNTS = np.random.RandomState(4).randint(-500, 500, (480, 3)).astype(np.int16)


def counts_of(path: Path, *, joined_parts: bool = False) -> np.ndarray:
    with open_recording(path, OPTIONS, joined=joined_parts) as reader:
        return joined(list(reader.chunks(1000))).counts


def gt3x(folder_: Path, name: str = "SUB01.gt3x", counts: np.ndarray = COUNTS) -> Path:
    parts = {"info.txt": make_gt3x.info(30), "log.bin": b"".join(make_gt3x.seconds(counts, 30))}
    (folder_ / name).write_bytes(make_gt3x.zipped(parts))
    return folder_ / name


def packed(files: dict[str, Path], path: Path, method: int = zipfile.ZIP_STORED) -> Path:
    if path.suffix == ".zip":
        with zipfile.ZipFile(path, "w", method) as made:
            for name, file in files.items():
                made.write(file, name)
        return path
    with tarfile.open(path, f"w:{path.suffix[1:]}" if path.suffix != ".tar" else "w") as tar:
        for name, file in files.items():
            tar.add(file, name)
    return path


def header(name: str, kind: bytes = b"0", size: int = 0) -> bytes:
    info = tarfile.TarInfo(name)
    info.type, info.size = kind, size
    return info.tobuf(tarfile.GNU_FORMAT)


def pax(keys: dict[str, str], kind: bytes = b"x") -> bytes:
    body = b""
    for key, value in keys.items():
        record = f" {key}={value}\n".encode()
        length = next(n for n in range(1, 10_000) if n == len(record) + len(str(n)))
        body += str(length).encode() + record
    return header("p", kind, len(body)) + body + bytes(-len(body) % 512)


ROWS = "time,x,y,z\n" + "".join(f"2024-03-04T00:00:{row / 10:06.3f},0.5,0.5,0.7\n" for row in range(300))


@pytest.mark.parametrize("suffix", [".zip", ".tar", ".tar.gz", ".tar.xz"])
@pytest.mark.parametrize("place", ["", "__a b/c/"])
def test_t4_an_archive_around_one_recording_is_that_recording(
    tmp_path: Path, suffix: str, place: str
) -> None:
    source = gt3x(tmp_path)
    (tmp_path / "readme.txt").write_text("recorded in spring\n")
    files = {f"{place}readme.txt": tmp_path / "readme.txt", f"{place}{source.name}": source}
    path = packed(files, tmp_path / f"SUB01{suffix}")
    with open_recording(path, OPTIONS, joined=False) as reader, open_recording(source, OPTIONS) as alone:
        assert (reader.recording.format, reader.recording.path) == ("gt3x", path)
        assert reader.recording.device == alone.recording.device
        assert np.array_equal(joined([*reader.chunks(1000)]).counts, joined([*alone.chunks(1000)]).counts)
        assert "no recordings, set aside: readme.txt" in reader.recording.notes


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_t4_a_gt3x_in_a_zip_without_a_directory_is_not_taken_for_the_zip(tmp_path: Path, method: int) -> None:
    path = packed({"SUB01.gt3x": gt3x(tmp_path)}, tmp_path / "SUB01.gt3x.zip", method)
    path.write_bytes(path.read_bytes()[:-30])
    assert not any(item.sniff(probe_file(path, OPTIONS)) for item in all_formats())
    with open_recording(path, OPTIONS, joined=False) as reader:
        assert reader.recording.format == "gt3x"
        told = [one.code for chunk in reader.chunks(1000) for one in chunk.problems]
    assert "truncated" in told


@pytest.mark.parametrize(
    "names", [("info.txt", "log.bin"), ("S 01/info.txt", "S 01/log.bin"), ("ä/info.txt", "ä/log.bin")]
)
@pytest.mark.parametrize("cut", [0, 40])
def test_t4_the_parts_of_a_gt3x_may_lie_in_a_folder(tmp_path: Path, names: tuple[str, str], cut: int) -> None:
    log = b"".join(make_gt3x.seconds(COUNTS, 30))
    data = make_gt3x.zipped(dict(zip(names, (make_gt3x.info(30), log), strict=True)))
    (tmp_path / "SUB01.gt3x").write_bytes(data[: len(data) - cut])
    assert np.array_equal(counts_of(tmp_path / "SUB01.gt3x"), counts_of(gt3x(tmp_path, "plain.gt3x")))


def test_t4_a_gt3x_with_two_folders_of_samples_names_them(tmp_path: Path) -> None:
    log = b"".join(make_gt3x.seconds(COUNTS, 30))
    parts = {f"{one}/{name}": data for one in "AB" for name, data in (("log.bin", log), ("info.txt", b"x"))}
    (tmp_path / "a.gt3x").write_bytes(make_gt3x.zipped(parts))
    with pytest.raises(UnreadableError, match="holds 2 recordings, in A and B"):
        open_recording(tmp_path / "a.gt3x", OPTIONS)


def test_t4_several_recordings_in_one_zip_are_told_with_the_commands(tmp_path: Path, capsys: Capture) -> None:
    files = {name: gt3x(tmp_path, name) for name in ("SUB01.gt3x", "SUB02.gt3x")}
    path = packed(files, tmp_path / "both in one.zip")
    ran = run(capsys, "calibrate", path, "-d", tmp_path / "out")
    assert ran.code == 3
    where = str(path.with_suffix(""))
    assert "holds 2 recordings (SUB01.gt3x and SUB02.gt3x)" in ran.err
    assert f"`unzip '{path}' -d '{where}'` and `accelcal study '{where}' -d OUT` calibrate each" in ran.err
    assert len(counts_of(path, joined_parts=True)) == len(COUNTS), "--parts takes them for parts of one"
    tar = packed(files, tmp_path / "both.tar.gz")
    assert f"`mkdir {tmp_path}/both && tar -xf {tar} -C {tmp_path}/both`" in run(capsys, "calibrate", tar).err


def test_recordings_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    files = {f"{side}/a.gt3x": gt3x(tmp_path, "a.gt3x") for side in ("left", "right")}
    with pytest.raises(UnreadableError, match=r"holds 2 recordings \(left/a.gt3x and right/a.gt3x\)"):
        open_recording(packed(files, tmp_path / "both.zip"), OPTIONS, joined=False)


def test_t4_a_second_recording_that_cannot_be_read_is_not_lost_in_silence(tmp_path: Path) -> None:
    (tmp_path / "SUB02.gt3x").write_bytes(b"PK\3\4" + bytes(500))
    files = {"SUB01.gt3x": gt3x(tmp_path), "SUB02.gt3x": tmp_path / "SUB02.gt3x"}
    with pytest.raises(UnreadableError, match="holds 2 recordings"):
        counts_of(packed(files, tmp_path / "both.zip"))


def test_t4_a_study_has_a_row_for_every_archive(tmp_path: Path, capsys: Capture) -> None:
    study_in = tmp_path / "in"
    study_in.mkdir()
    table = write_csv(tmp_path / "one.csv", still_counts(directions(40)))
    packed({"one.csv": table}, study_in / "one.zip")
    packed({name: gt3x(tmp_path, name) for name in ("A.gt3x", "B.gt3x")}, study_in / "two.tar.gz")
    packed({"photo.jpg": table, "notes.txt": table}, study_in / "photos.zip")
    (study_in / "cut.zip").write_bytes((study_in / "one.zip").read_bytes()[:40])
    assert study(capsys, study_in, "--report-only").code == 1
    found = {row["path"]: row["outcome"] for row in rows(tmp_path / "out")}
    assert found["one.zip"] == "calibrated"
    assert {"two.tar.gz", "cut.zip"} < set(found)
    assert "photos.zip" not in found
    assert "holds 2 recordings (A.gt3x and B.gt3x)" in (tmp_path / "out/study.csv").read_text()


def test_t4_a_unisens_folder_in_a_zip_is_one_recording(tmp_path: Path) -> None:
    acc, ecg = signal("acc.bin", "acc"), signal("ecg.bin", "ecg", channels=("a",), unit="mV")
    xml = folder(tmp_path / "u", description(acc, ecg), acc=COUNTS.astype("<i2").tobytes(), ecg=bytes(900))
    path = packed({f"S01/{one.name}": one for one in sorted(xml.parent.iterdir())}, tmp_path / "S01.zip")
    assert np.array_equal(counts_of(path), counts_of(xml))


def test_t4_one_recording_needs_no_times(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z\n" + "0.5,0.5,0.7\n" * 200)
    path = packed({"a.csv": tmp_path / "a.csv"}, tmp_path / "a.zip")
    with open_recording(path, ReadOptions(rate_hz=25.0), joined=False) as reader:
        assert sum(map(len, reader.chunks(50))) == 200
        assert reader.recording.start_us is None


def test_t5_no_message_names_a_temporary_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "here_it_was_unpacked"))
    (tmp_path / "here_it_was_unpacked").mkdir()
    (tmp_path / "a.csv").write_text("x,y,z\n" + "0.5,0.5,0.7\n" * 200)
    make_cwa.make(tmp_path, np.ones((960, 3), np.int16), 100.0, 256.0)
    (cwa,) = tmp_path.glob("*.cwa")
    for name, file in {"a.csv": tmp_path / "a.csv", "a.cwa": cwa}.items():
        path = packed({f"meta/{name}": file, f"b/{name}": file}, tmp_path / f"{name}.zip")
        with pytest.raises(UnreadableError) as caught:
            counts_of(path)
        assert "here_it_was_unpacked" not in str(caught.value)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(header("a.csv", b"S") + bytes(2048), id="old GNU"),
        pytest.param(
            pax({"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.name": "a.csv"})
            + header("a.csv", b"0", 1 << 40),
            id="1.0",
        ),
        pytest.param(pax({"GNU.sparse.map": "0,1", "GNU.sparse.size": "9"}) + header("a.csv"), id="0.1"),
        pytest.param(pax({"GNU.sparse.map": "0,1"}, b"g") + header("a.csv"), id="global"),
    ],
)
def test_h2_sparse_files_are_refused_before_their_maps_are_read(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.tar"
    path.write_bytes(data + bytes(1024))
    with pytest.raises(UnreadableError, match=r"a\.csv in it is a sparse file, which is not unpacked"):
        unpack(path, tmp_path, lambda _name: True)
    assert list(first_names(path, 5)) == []


def test_h2_global_headers_are_counted_and_read_in_passing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, one = tmp_path / "a.tar", pax({f"k{number}": "v" for number in range(2000)}, b"g")
    end = header("a.csv", b"0", len(ROWS)) + ROWS.encode().ljust(-(-len(ROWS) // 512) * 512, b"\0")
    path.write_bytes(one * 30 + end + bytes(1024))
    assert [file.read_text() for file in unpack(path, tmp_path, lambda _name: True).files] == [ROWS]
    monkeypatch.setattr(archive, "MOST_MEMBERS", 20)
    with pytest.raises(UnreadableError, match="has more than 20 members"):
        unpack(path, tmp_path, lambda _name: True)


def test_h3_members_of_any_kind_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "MOST_MEMBERS", 50)
    for kind in (b"5", b"2", b"3", b"6", b"V"):
        path = tmp_path / "a.tar"
        path.write_bytes(header("d", kind) * 60 + bytes(1024))
        with pytest.raises(UnreadableError, match="has more than 50 members"):
            unpack(path, tmp_path, lambda _name: True)
        assert list(first_names(path, 5)) == []


def test_names_and_sizes_of_pax_headers_are_used(tmp_path: Path) -> None:
    path, text = tmp_path / "a.tar", ROWS.encode()
    long = "d/" + "n" * 150 + ".csv"
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as tar:
        info = tarfile.TarInfo(long)
        info.size, info.pax_headers = len(text), {"size": str(len(text)), "comment": "\u00e9" * 100}
        tar.addfile(info, io.BytesIO(text))
    (found,) = unpack(path, tmp_path, lambda _name: True).files
    assert (found.name, found.read_bytes()) == (long[2:], text)


def streamed(
    names: list[str], data: bytes, method: int = zipfile.ZIP_DEFLATED, *, zip64: bool = False
) -> bytes:
    """A zip file as a program writes it to a pipe: checksums and sizes follow the data."""

    class Pipe(io.RawIOBase):
        def __init__(self) -> None:
            self.data = b""

        def writable(self) -> bool:
            return True

        def write(self, data: object) -> int:
            self.data += bytes(data)  # type: ignore[call-overload]
            return len(bytes(data))  # type: ignore[call-overload]

    pipe = Pipe()
    with zipfile.ZipFile(pipe, "w", method) as made:  # type: ignore[call-overload]
        for name in names:
            with made.open(name, "w", force_zip64=zip64) as file:
                file.write(data)
    return pipe.data


def in_place(
    names: list[str], data: bytes, method: int = zipfile.ZIP_DEFLATED, *, zip64: bool = False
) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as made:
        for name in names:
            with made.open(name, "w", force_zip64=zip64) as member:
                member.write(data)
    return file.getvalue()


@pytest.mark.parametrize("zip64", [False, True])
@pytest.mark.parametrize("make", [streamed, in_place])
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_h11_a_zip_cut_anywhere_ends_with_the_parts_before(
    tmp_path: Path, make: object, method: int, zip64: bool
) -> None:
    data = np.random.RandomState(1).bytes(5000) + bytes(300_000)
    whole = make(["a.csv", "b.csv", "c.csv"], data, method, zip64=zip64)  # type: ignore[operator]
    ends = [at for at in range(len(whole)) if whole.startswith((b"PK\3\4", b"PK\1\2"), at)]
    path, step = tmp_path / "a.zip", max(1, len(whole) // 60)
    for cut in [*range(100, len(whole) - 25, step), len(whole) - 25]:
        path.write_bytes(whole[:cut])
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        (tmp_path / "out").mkdir()
        begun = time.process_time()
        try:
            found = unpack(path, tmp_path / "out", lambda _name: True)
            number = len(found.files)
            assert found.damage == f"the archive breaks off after {found.files[-1].name}"
            assert all(file.read_bytes() == data for file in found.files)
        except UnreadableError as error:
            assert "nothing can be unpacked" in error.message
            number = 0
        assert time.process_time() - begun < 5
        complete = sum(end <= cut for end in ends[1:4])
        if method == zipfile.ZIP_DEFLATED or make is in_place:
            assert complete <= number <= min(3, complete + 1), "a checksum may lie before the next header"


def test_h11_parts_of_a_cut_zip64_file_come_through(tmp_path: Path) -> None:
    files = in_place(["a.csv", "b.csv"], ROWS.encode(), zip64=True)
    path = tmp_path / "a.zip"
    path.write_bytes(files[: len(files) // 2 + 40])
    assert [file.read_text() for file in unpack(path, tmp_path, lambda _name: True).files][:1] == [ROWS]


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_h12_other_packings_are_refused_before_they_unpack(tmp_path: Path, method: int) -> None:
    path = tmp_path / "a.zip"
    path.write_bytes(in_place(["a.csv"], bytes(1 << 24), method))
    with pytest.raises(UnreadableError, match=r"a\.csv in it is packed with (bzip2|LZMA), which is not"):
        unpack(path, tmp_path, lambda _name: True)
    path.write_bytes(path.read_bytes()[:-22])
    with pytest.raises(UnreadableError, match=r"packed with (bzip2|LZMA)"):
        unpack(path, tmp_path, lambda _name: True)


def test_h12_a_dictionary_of_xz_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = lzma.compress(header("a.csv", b"0", 6) + b"1,2,3\n".ljust(512, b"\0") + bytes(1024))
    (tmp_path / "a.tar.xz").write_bytes(data + lzma.compress(b"") + bytes(4))
    assert list(first_names(tmp_path / "a.tar.xz", 5)) == ["a.csv"]
    assert len(unpack(tmp_path / "a.tar.xz", tmp_path, lambda _name: True).files) == 1
    monkeypatch.setattr(unpacking, "XZ_MEMORY", 1 << 16)
    with pytest.raises(UnreadableError, match=r"takes more than 128 MB of memory; unpack it first: unxz -k"):
        unpack(tmp_path / "a.tar.xz", tmp_path, lambda _name: True)


def test_h13_members_without_bytes_cost_next_to_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as made:
        for number in range(20_000):
            made.writestr(f"{number}.csv", b"")
        made.writestr("one.csv", ROWS)
    begun = time.process_time()
    with open_recording(path, OPTIONS, joined=False) as reader:
        assert sum(map(len, reader.chunks(1000))) == 300
        assert any(
            f"{20_000 - archive.MOST_EMPTY} empty files" in note for note in reader.recording.notes
        ) or ("more" in reader.recording.notes[-1])
    assert time.process_time() - begun < 5


def test_h17_an_encrypted_zip_says_so_and_names_what_to_give(tmp_path: Path, capsys: Capture) -> None:
    data = bytearray(in_place(["S01/a.csv"], ROWS.encode()))
    for sign, place in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        data[data.index(sign) + place] |= 1
    (tmp_path / "a.zip").write_bytes(data)
    ran = run(capsys, "calibrate", tmp_path / "a.zip")
    assert (ran.code, "is encrypted; unpack it with its password, and give a.csv" in ran.err) == (3, True)


def test_h17_parts_with_a_zip_of_recordings_name_it(tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    write_csv(tmp_path / "p/a.csv", still_counts(directions(2)))
    packed({"b.csv": tmp_path / "p/a.csv"}, tmp_path / "p/b.zip")
    with open_recording(tmp_path / "p", OPTIONS, joined=True) as reader:
        told = [one for chunk in reader.chunks(1000) for one in chunk.problems]
    assert [one.code for one in told] == ["unreadable_part"]
    assert "b.zip" in told[0].message


@pytest.mark.parametrize("name", ["b.zip", "b.tar.gz"])
def test_an_archive_in_an_archive_is_to_be_unpacked_first(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.csv").write_text(ROWS)
    inner, outer = packed({"a.csv": tmp_path / "a.csv"}, tmp_path / name), tmp_path / "a.zip"
    with pytest.raises(UnreadableError, match=rf"a.zip/{name}: is an archive: unpack it first"):
        counts_of(packed({name: inner}, outer))
    with open_recording(packed({name: inner, "S.gt3x": gt3x(tmp_path)}, outer), OPTIONS) as reader:
        told = f"no recordings, set aside: {name} (is an archive: unpack it first)"
        assert told in reader.recording.notes


def test_bz2_of_several_streams_is_read_to_its_end(tmp_path: Path) -> None:
    half = header("a.csv", b"0", 1024) + b"1,2,3\n" * 86 + bytes(508)
    (tmp_path / "a.tar.bz2").write_bytes(bz2.compress(half) + bz2.compress(bytes(1024)))
    assert unpack(tmp_path / "a.tar.bz2", tmp_path, lambda _name: True).damage is None

"""Files of each kind of container that claim, unpack to, or consist of, far more than they are worth."""

from __future__ import annotations

import io
import json
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest

from tests.faults.shim import Runner
from tests.faults.test_hostile_formats import assert_harmless
from tests.formats import (
    make_edf,
    make_embraceplus,
    make_geneactiv,
    make_mat,
    make_npz,
    make_unisens,
    make_wav,
)

COUNTS = np.random.RandomState(3).randint(-500, 500, (3000, 3)).astype(np.int16)
MEGABYTE = 1 << 20
ENTITIES = '<!DOCTYPE u [<!ENTITY a0 "ha">' + "".join(
    f'<!ENTITY a{number} "{f"&a{number - 1};" * 10}">' for number in range(1, 11)
)


def npz_of_a_claim(path: Path) -> None:
    head = "{'descr': '<i2', 'fortran_order': False, 'shape': (3074457345618258602, 3), }"
    path.write_bytes(make_npz.archive({"accel": make_npz.member(COUNTS, head=head)}))


def npz_of_zeros(path: Path) -> None:
    head = f"{{'descr': '<i2', 'fortran_order': False, 'shape': ({256 * MEGABYTE // 6}, 3), }}"
    data = make_npz.member(np.zeros((0, 3), np.int16), head=head) + bytes(256 * MEGABYTE // 6 * 6)
    path.write_bytes(make_npz.archive({"accel": data, "fs": make_npz.member(np.float64(25))}, packed=True))


def npz_of_objects(path: Path) -> None:
    head = "{'descr': '|O', 'fortran_order': False, 'shape': (3000, 3), }"
    path.write_bytes(make_npz.archive({"accel": make_npz.member(COUNTS, head=head)}))


def mat_of_a_claim(path: Path) -> None:
    values = make_mat.element(3, COUNTS.tobytes())
    path.write_bytes(make_mat.file_of([make_mat.array(10, (2**31 - 1, 2**31 - 1), "accel", values)]))


def mat_of_zeros(path: Path) -> None:
    size = 128 * MEGABYTE
    head = struct.pack("<II", 6, 8) + struct.pack("<II", 10, 0) + struct.pack("<IIii", 5, 8, size // 6, 3)
    body = head + make_mat.element(1, b"accel") + struct.pack("<II", 3, size // 6 * 6) + bytes(size // 6 * 6)
    path.write_bytes(make_mat.file_of([struct.pack("<II", 14, len(body)) + body], packed=True))


def mat_within_itself(path: Path) -> None:
    parts = make_mat.matrix("", COUNTS[:, 0])
    for _ in range(3000):
        parts = make_mat.array(1, (1, 1), "", parts)
    path.write_bytes(make_mat.file_of([parts]))


def wav_of_a_claim(path: Path) -> None:
    data = make_wav.samples(COUNTS.astype(int))
    path.write_bytes(make_wav.header(2**32 - 2000, rate_hz=2**31 // 8, channels=4) + data)


def wav_of_many_channels(path: Path) -> None:
    form = make_wav.chunk(b"fmt ", struct.pack("<HHIIHH", 1, 65535, 2**32 - 1, 2**32 - 1, 65534, 16))
    path.write_bytes(make_wav.header(2**31, fmt=form) + bytes(MEGABYTE))


def edf_of_claims(path: Path) -> None:
    signals = make_edf.xyz(COUNTS, 50)
    data = bytearray(make_edf.written(signals, "1"))
    data[236:244], data[244:252] = b"99999999", b"99999999"
    data[256 + 3 * 216 : 256 + 3 * 224] = b"99999999" * 3
    path.write_bytes(bytes(data))


def edf_of_many_signals(path: Path) -> None:
    signals = make_edf.xyz(np.zeros((3, 3), np.int16), 1) * 3333
    path.write_bytes(make_edf.written(signals, "1"))


def avro_of_claims(path: Path) -> None:
    data = make_embraceplus.written(COUNTS, 256.0, codec="null")
    at = data.index(make_embraceplus.MARKER) + 16
    path.write_bytes(data[:at] + make_embraceplus.long(2**62) + make_embraceplus.long(2**62) + data[at + 4 :])


def avro_of_zeros(path: Path) -> None:
    body = bytes(256 * MEGABYTE)
    path.write_bytes(make_embraceplus.container(body, make_embraceplus.schema(True)))


def avro_of_a_deep_schema(path: Path) -> None:
    schema: object = "int"
    for _ in range(300):
        schema = {"type": "array", "items": schema}
    path.write_bytes(make_embraceplus.container(bytes(100), schema))


def parquet_of_many_rows(path: Path) -> None:
    """A few kilobytes of equal rows."""
    rows = 3_000_000
    columns = {
        "time": pa.array(np.zeros(rows, np.int64)),
        **{name: pa.array(np.zeros(rows)) for name in "xyz"},
    }
    pq.write_table(pa.table(columns), path, row_group_size=rows, data_page_size=1 << 30, compression="gzip")


def parquet_of_many_columns(path: Path) -> None:
    pq.write_table(pa.table({f"c{number}": [0.5] for number in range(5_000)}), path)


def feather_of_zeros(path: Path) -> None:
    rows = 8_000_000
    columns = {"time": np.zeros(rows, np.int64), **{name: np.zeros(rows) for name in "xyz"}}
    pyarrow.feather.write_feather(pa.table(columns), path, compression="zstd", chunksize=rows)


def csv_of_a_million_columns(path: Path) -> None:
    line = ",".join(["1"] * 1_000_000)
    path.write_text(f"{line}\n{line}\n")


def csv_of_quotes(path: Path) -> None:
    path.write_text('time,x,y,z\n"' + '""' * (4 * MEGABYTE))


def geneactiv_of_a_long_header(path: Path) -> None:
    path.write_bytes(make_geneactiv.header(pages=10**12) + b"Note:a\r\n" * 1_000_000)


def zip_in_zip(path: Path) -> None:
    data = b"time,x,y,z\n"
    for depth in range(50):
        held = io.BytesIO()
        with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{depth}.zip", data)
        data = held.getvalue()
    path.write_bytes(data)


def tar_of_links(path: Path) -> None:
    with tarfile.open(path, "w") as archive:
        for name, kind, target in (
            ("a.csv", tarfile.SYMTYPE, "/etc/passwd"),
            ("b.csv", tarfile.LNKTYPE, "../../../../etc/passwd"),
            ("../../c.csv", tarfile.REGTYPE, ""),
            ("d.csv", tarfile.FIFOTYPE, ""),
            ("e.csv", tarfile.CHRTYPE, ""),
        ):
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, target
            archive.addfile(member)


def zip_of_many(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(110_000):
            archive.writestr(zipfile.ZipInfo(f"{number}.csv"), b"")


def _unisens(path: Path, before: str, own: str, name: str = "acc.bin") -> None:
    signal = make_unisens.signal(name, "acc", sampleRate=50, lsbValue=1 / 256)
    text = make_unisens.description(signal, own=own)
    head, _, rest = text.partition("\n")
    path.write_text(f"{head}\n{before}{rest}")
    (path.parent / "acc.bin").write_bytes(COUNTS.tobytes())


def unisens_of_entities(path: Path) -> None:
    _unisens(path, ENTITIES + "]>\n", '<customAttribute key="a" value="&a10;"/>')


def unisens_of_another_file(path: Path) -> None:
    before = (
        '<!DOCTYPE u [<!ENTITY x SYSTEM "file:///etc/hostname"><!ENTITY % y SYSTEM "/etc/passwd"> %y;]>\n'
    )
    _unisens(path, before, "<customAttribute>&x;</customAttribute>")


def unisens_of_another_folder(path: Path) -> None:
    _unisens(path, "", "", "../elsewhere.bin")


def unisens_that_is_deep(path: Path) -> None:
    _unisens(path, "", "<a>" * 100_000 + "</a>" * 100_000)


def layout_of_claims(path: Path) -> None:
    path.write_bytes(bytes(6000))
    fields = "".join(
        f"{axis} = {{ offset = {2**62 + index}, type = 'int16' }}\n" for index, axis in enumerate("xyz")
    )
    sizes = f"header_bytes = {2**62}\nrecord_bytes = {2**62}\n"
    head = f"[dump]\nrate_hz = 25\nlsb_per_g = 256\nrange_g = 8.0\n{sizes}[fields]\n"
    path.with_name("a.layout.toml").write_text(head + fields)


def tables_of_json(path: Path) -> None:
    path.write_text(json.dumps([[0] * 10] * 100_000))


CASES: dict[str, tuple[Callable[[Path], None], ...]] = {
    "a.npz": (npz_of_a_claim, npz_of_zeros, npz_of_objects),
    "a.mat": (mat_of_a_claim, mat_of_zeros, mat_within_itself),
    "a.wav": (wav_of_a_claim, wav_of_many_channels),
    "a.edf": (edf_of_claims, edf_of_many_signals),
    "a.avro": (avro_of_claims, avro_of_zeros, avro_of_a_deep_schema),
    "a.parquet": (parquet_of_many_rows, parquet_of_many_columns),
    "a.feather": (feather_of_zeros,),
    "a.csv": (csv_of_a_million_columns, csv_of_quotes, tables_of_json),
    "a.bin": (geneactiv_of_a_long_header,),
    "a.zip": (zip_in_zip, zip_of_many),
    "a.tar": (tar_of_links,),
    "unisens.xml": (
        unisens_of_entities, unisens_of_another_file, unisens_of_another_folder, unisens_that_is_deep,
    ),
    "a.raw": (layout_of_claims,),
}  # fmt: skip

LONG = (
    npz_of_zeros, mat_of_zeros, avro_of_zeros, parquet_of_many_rows, feather_of_zeros, zip_of_many,
    csv_of_a_million_columns, edf_of_many_signals, geneactiv_of_a_long_header,
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "make"),
    [
        pytest.param(name, make, marks=[pytest.mark.nightly] if make in LONG else [])
        for name, makers in CASES.items() for make in makers
    ],
    ids=lambda one: one if isinstance(one, str) else one.__name__,
)  # fmt: skip
def test_it_is_read_or_refused_within_limits(
    runner: Runner, tmp_path: Path, name: str, make: Callable[[Path], None]
) -> None:
    for folder in ("in", "out", "tmp"):
        (tmp_path / folder).mkdir()
    (tmp_path / "elsewhere.bin").write_bytes(COUNTS.tobytes())
    make(tmp_path / "in" / name)
    struck = runner.run(["calibrate", f"in/{name}", "-d", "out", "-q", "--html"], tmp_path, limit_s=60)
    assert_harmless(struck, tmp_path, runner.folder)
    assert struck.ran.code in (2, 3, 4), struck
    assert not any((tmp_path / "tmp").iterdir())
    assert not [path for path in struck.opened if "elsewhere" in path or path.startswith("/etc/")]

"""The floor: read, decode and write the same rows with the same columns and codec, on one thread.

`python -m bench.floor FORMAT RECORDING [OUT.parquet]`; without OUT only reading and decoding. Each
does what no program can leave out, in the fastest plain way: no checks but checksums, no
stillness, no fit.
"""

from __future__ import annotations

import binascii
import os
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

BLOCK_BYTES = 1 << 22
Columns = dict[str, np.ndarray[Any, Any]]


def cwa(path: Path) -> Iterator[Columns]:
    """Unpacked sectors of 80 samples; two words of a checksum sum to zero."""
    with path.open("rb") as file:
        file.seek(1024)
        while data := file.read(BLOCK_BYTES // 512 * 512):
            words = np.frombuffer(data, "<u2").reshape(-1, 256)
            assert not words.sum(axis=1, dtype=np.uint16).any()
            rows = int(words[0, 14])
            packed = (words[0, 12] >> 8) & 0x0F == 0
            if packed:
                counts = _packed(words[:, 15 : 15 + 2 * rows].copy().view("<u4"))
            else:
                counts = words[:, 15 : 15 + 3 * rows].view("<i2").reshape(-1, 3)
            warm = np.repeat(words[:, 10].astype(np.float32), rows)
            yield {**_xyz(counts), "temperature": warm}


def _packed(words: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    flat = words.reshape(-1)
    shift = (flat >> np.uint32(30)).astype(np.int32)
    axes = [((flat << np.uint32(22 - 10 * axis)).view(np.int32) >> 22) << shift for axis in range(3)]
    return np.stack(axes, axis=1)


def flash(path: Path) -> Iterator[Columns]:
    """Our own pages, as sectors of 512 bytes with int16 triples."""
    with path.open("rb") as file:
        while data := file.read(BLOCK_BYTES // 512 * 512):
            pages = np.frombuffer(data, np.uint8)[: len(data) // 512 * 512].reshape(-1, 512)
            zlib.crc32(data)
            yield _xyz(pages[:, 24:504].copy().view("<i2").reshape(-1, 3))


def raw(path: Path) -> Iterator[Columns]:
    """Frames of three int16."""
    with path.open("rb") as file:
        while data := file.read(BLOCK_BYTES // 6 * 6):
            yield _xyz(np.frombuffer(data, "<i2")[: len(data) // 6 * 3].reshape(-1, 3))


def hdf5(path: Path) -> Iterator[Columns]:
    """All datasets as long as the one of accelerations, by its chunks."""
    import h5py

    with h5py.File(path) as file:
        found: list[Any] = []
        file.visititems(lambda _, item: found.append(item) if getattr(item, "shape", None) else None)
        accel = next(item for item in found if item.shape[1:] == (3,))
        others = [item for item in found if item.shape == accel.shape[:1]]
        step = (accel.chunks or (1 << 17,))[0]
        for start in range(0, len(accel), step):
            more = {item.name.strip("/"): item[start : start + step] for item in others}
            yield _xyz(accel[start : start + step]) | more


def csv(path: Path) -> Iterator[Columns]:
    """pyarrow's streaming parser."""
    from pyarrow import csv as arrow

    for batch in arrow.open_csv(path, read_options=arrow.ReadOptions(use_threads=False)):
        yield _xyz(np.stack([batch.column(name).to_numpy(zero_copy_only=False) for name in "xyz"], axis=1))


def gt3x(path: Path) -> Iterator[Columns]:
    """Only the inflation of log.bin: its bytes, counted as rows of nothing."""
    with zipfile.ZipFile(path) as box, box.open("log.bin") as file:
        while data := file.read(BLOCK_BYTES):
            zlib.crc32(data)
            yield {}


def geneactiv(path: Path) -> Iterator[Columns]:
    """The hexadecimal lines of 300 samples."""
    with path.open("rb") as file:
        for line in file:
            if len(line) > 3600:
                data = np.frombuffer(binascii.unhexlify(line[:3600]), np.uint8).reshape(-1, 6)
                wide = data.astype(np.int16)
                x = (wide[:, 0] << 4) | (wide[:, 1] >> 4)
                y = ((wide[:, 1] & 15) << 8) | wide[:, 2]
                z = (wide[:, 3] << 4) | (wide[:, 4] >> 4)
                yield _xyz(np.stack([x, y, z], axis=1))


READ: dict[str, Callable[[Path], Iterator[Columns]]] = {
    name: globals()[name] for name in ("cwa", "flash", "raw", "hdf5", "csv", "gt3x", "geneactiv")
}


GAIN = np.array([[1.02, 0, 0], [0.012, 0.985, 0], [-0.008, 0.006, 1.01]], np.float32) / np.float32(256)
"""Some calibration, so that what is compressed is as hard to compress as calibrated values are."""


def _xyz(counts: np.ndarray[Any, Any]) -> Columns:
    g = GAIN @ counts.T.astype(np.float32)
    return dict(zip("xyz", g, strict=True))


def write(chunks: Iterator[Columns], out: Path) -> None:
    """Row groups of a million rows, as accelcal writes them."""
    writer, held, rows, first = None, [], 0, 0
    for chunk in chunks:
        held.append(chunk)
        rows += len(chunk["x"])
        while rows >= 1 << 20:
            joined = {name: np.concatenate([part[name] for part in held]) for name in held[0]}
            held, rows = [{name: values[1 << 20 :] for name, values in joined.items()}], rows - (1 << 20)
            writer = _group(writer, {name: values[: 1 << 20] for name, values in joined.items()}, first, out)
            first += 1 << 20
    joined = {name: np.concatenate([part[name] for part in held]) for name in held[0]}
    writer = _group(writer, joined, first, out)
    writer.close()


def _group(writer: pq.ParquetWriter | None, columns: Columns, first: int, out: Path) -> pq.ParquetWriter:
    number = len(columns["x"])
    time = 1_700_000_000_000_000 + (np.arange(first, first + number, dtype=np.int64) * 10_000)
    whole = {"time": pa.array(time).view(pa.timestamp("us")), **{k: pa.array(v) for k, v in columns.items()}}
    whole["validity"] = pa.array(np.zeros(number, np.uint8))
    batch = pa.RecordBatch.from_pydict(whole)
    if writer is None:
        encodings = dict.fromkeys(whole, "PLAIN")
        encodings |= {"z": "BYTE_STREAM_SPLIT", "time": "DELTA_BINARY_PACKED"}
        writer = pq.ParquetWriter(
            out,
            batch.schema,
            compression="zstd",
            compression_level=1,
            use_dictionary=False,
            column_encoding=encodings,
            write_batch_size=1 << 16,
            write_statistics=["time"],
        )
    writer.write_batch(batch, 1 << 20)
    return writer


def main(words: list[str]) -> None:
    """Read, and write where a third word says so."""
    chunks = READ[words[0]](Path(words[1]))
    if len(words) > 2:
        write(chunks, Path(words[2]))
    else:
        for _ in chunks:
            pass


if __name__ == "__main__":
    pa.set_cpu_count(1)
    main(sys.argv[1:])

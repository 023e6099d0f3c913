"""Writes small NumPy archives byte by byte: the heads of arrays by hand, zip files with the standard library.

Source: NumPy's documentation, "numpy.lib.format".
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from tests.formats.expected import Expected
from tests.formats.make_hdf5 import even_times


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """What skdh takes: `time` in seconds since 1970, `accel` in g, `fs`; not packed."""
    path, times = folder / "made.npz", even_times(len(counts), rate_hz)
    write(path, {"time": times / 1e6, "accel": counts / lsb_per_g, "fs": np.float64(rate_hz), "unit": "g"})
    return Expected(path, counts / lsb_per_g, rate_hz, times, 0)


def member(array: Any, version: tuple[int, int] = (1, 0), head: str | None = None) -> bytes:
    """An array as the bytes of a .npy file; `head` instead of the right one."""
    values = np.asarray(array)
    column_major = values.flags.f_contiguous and not values.flags.c_contiguous
    about = head or (
        f"{{'descr': {values.dtype.str!r}, 'fortran_order': {column_major}, 'shape': {values.shape!r}, }}"
    )
    width = 2 if version == (1, 0) else 4
    length = -(-(6 + 2 + width + len(about) + 1) // 64) * 64
    text = about.encode().ljust(length - 8 - width - 1) + b"\n"
    raw = values.tobytes("F" if column_major else "C")
    return b"\x93NUMPY" + bytes(version) + len(text).to_bytes(width, "little") + text + raw


def archive(members: dict[str, bytes], packed: bool = False) -> bytes:
    """A zip file of .npy files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as file:
        for name, data in members.items():
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), data, file.compression)
    return buffer.getvalue()


def write(path: Path, arrays: dict[str, Any], packed: bool = False) -> Path:
    """An archive of these arrays."""
    path.write_bytes(archive({name: member(array) for name, array in arrays.items()}, packed))
    return path

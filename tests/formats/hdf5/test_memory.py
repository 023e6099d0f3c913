"""The claims of a damaged HDF5 file do not decide how much memory it takes."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np

from tests.formats.make_hdf5 import about, read, write


def test_a_text_whose_length_is_damaged_takes_no_memory(tmp_path: Path) -> None:
    path, counts = tmp_path / "a.h5", np.ones((500, 3), np.int16)
    write(path, {"accel": counts}, about(serial="0042"))
    assert read(path).recording.device.serial == "0042"
    data = path.read_bytes()
    heap = data.index(b"GCOL").to_bytes(8, "little")
    place = data.index((4).to_bytes(4, "little") + heap)
    path.write_bytes(data[:place] + b"\xf0\xff\xff\xf0" + data[place + 4 :])
    limits = resource.getrlimit(resource.RLIMIT_AS)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = read(path)
    assert (found.recording.device.serial, len(found.counts)) == (None, 500)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300 << 10
    assert resource.getrlimit(resource.RLIMIT_AS) == limits

"""Only HDF5 files make the program wait until h5py is loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

LOOK = """
import sys
from pathlib import Path
from accelcal_cli.core.formats import ReadOptions, probe_file
from accelcal_cli.formats import all_formats
for path in sys.argv[1:]:
    probe = probe_file(Path(path), ReadOptions())
    scores = [item.sniff(probe) for item in all_formats() if item.name in ("hdf5", "opal")]
    print(scores, "h5py" in sys.modules)
"""


def test_h5py_is_loaded_where_the_signature_is_there(tmp_path: Path) -> None:
    other, signed = tmp_path / "a.h5", tmp_path / "b.bin"
    other.write_bytes(bytes(9000))
    signed.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(9000))
    look = [sys.executable, "-c", LOOK, other, signed]
    seen = subprocess.run(look, capture_output=True, text=True, check=True).stdout
    assert seen == "[0, 0] False\n[90, 0] True\n"

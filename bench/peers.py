"""Other tools on the same recording, in a Python of their own (`make bench-peers`)."""

from __future__ import annotations

import subprocess
from pathlib import Path

from bench.process import Command

ACTIPY = """
import sys, actipy
data, info = actipy.read_device(sys.argv[1], lowpass_hz=None, calibrate_gravity=True, detect_nonwear=False,
                                resample_hz=None)
data.to_parquet(sys.argv[2])
"""

ACTIPY_READ = """
import sys, actipy
actipy.read_device(sys.argv[1], lowpass_hz=None, calibrate_gravity=False, detect_nonwear=False,
                   resample_hz=None)
"""

SKDH_CWA = """
import sys, pandas, skdh
from skdh.io import ReadCwa
from skdh.preprocessing import CalibrateAccelerometer
held = ReadCwa().predict(file=sys.argv[1])
held |= CalibrateAccelerometer().predict(**held)
frame = pandas.DataFrame({"time": held["time"], **dict(zip("xyz", held["accel"].T))})
frame.to_parquet(sys.argv[2])
"""

READ = " (read)"
"""How names of tools end that read a format only."""

SCRIPTS = {
    ("actipy", "cwa"): ACTIPY,
    ("skdh", "cwa"): SKDH_CWA,
    ("actipy" + READ, "gt3x"): ACTIPY_READ,
    ("actipy" + READ, "geneactiv"): ACTIPY_READ,
}


def peer_commands(python: Path, case: str, path: Path) -> dict[str, Command]:
    """Commands of the peers that read this format and are installed, by their names."""
    made = path.parent / "peer.parquet"
    return {
        tool: Command([str(python), "-c", script, str(path), str(made)], None if READ in tool else made)
        for (tool, format_name), script in SCRIPTS.items()
        if format_name == case and _installed(python, tool.removesuffix(READ))
    }


def _installed(python: Path, module: str) -> bool:
    done = subprocess.run([str(python), "-c", f"import {module}"], capture_output=True, check=False)
    return done.returncode == 0

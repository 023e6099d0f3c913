"""Matrix products take one thread: none waits spinning while others work."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COUNT = """
import os
from accelcal_cli.core.system import hold_to_one_thread
hold_to_one_thread()
import numpy as np
np.ones((500, 500)) @ np.ones((500, 500))
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads are listed by Linux")
def test_a_product_starts_no_thread() -> None:
    wanted = os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", COUNT], capture_output=True, text=True, check=True, env=wanted
    )
    assert done.stdout == "1\n"

"""How many threads the linear algebra below numpy takes."""

from __future__ import annotations

import os

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What OpenMP, OpenBLAS and MKL ask for, in this process and those it starts."""


def hold_to_one_thread() -> None:
    """Let matrix products take one thread each; to be called before numpy is loaded.

    By default they take one for every CPU, which wait for each other spinning: what they took from the
    thread that encodes, half a second of a week's recording, the small products here never gave back.
    One thread also adds in the same order on every machine.
    """
    os.environ.update(dict.fromkeys(NAMES, "1"))

"""Progress on stderr, only where it is a terminal."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

from accelcal_cli.pipeline.request import Progress, ProgressMaker, no_progress


@contextlib.contextmanager
def progress_bars(label: str, *, quiet: bool, unit: str = "B") -> Iterator[ProgressMaker]:
    """A maker of bars for the stages of one recording; each replaces the one before."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield no_progress
        return
    from tqdm import tqdm

    with contextlib.ExitStack() as stack:

        def make(stage: str, total: int) -> Progress:
            stack.close()
            bar = tqdm(
                total=total, desc=f"{label} {stage}", unit=unit, unit_scale=True, leave=False, file=sys.stderr
            )
            stack.callback(bar.close)
            return lambda done: bar.update(min(done, total) - bar.n) and None

        yield make

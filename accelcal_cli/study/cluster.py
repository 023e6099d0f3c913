"""Tasks done by a cluster of dask.distributed; what befalls a worker there is made good elsewhere."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

from accelcal_cli.study.connect import connected
from accelcal_cli.study.engine import Ended
from accelcal_cli.study.session import Session, Wishes


@dataclass(slots=True)
class Cluster(Wishes):
    """The workers of a scheduler."""

    def run(self, tasks: list[Any]) -> Generator[Ended, None, None]:
        """See `Engine`.

        Raises:
            UsageError: distributed is not installed.
            ClusterError: the scheduler cannot be reached or is lost, or a worker does not meet the terms.
            OutputError: a worker cannot write where the outputs go.
        """
        if tasks:
            with connected(self.told, self.said) as client:
                yield from Session(self, client, deque(tasks)).run()

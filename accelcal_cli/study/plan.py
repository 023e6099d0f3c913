"""What is asked of a study."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli import __version__
from accelcal_cli.pipeline.request import Request
from accelcal_cli.study.find import Where
from accelcal_cli.study.ledger import Ledger
from accelcal_cli.study.shard import Shard

WHOLE = Shard()
POOL, POOLED, BORROW = "pool", "pooled", "borrow"
REPLACING = (POOLED, BORROW)
"""Rounds after that of the own results that may replace one."""


@dataclass(frozen=True, slots=True)
class Study:
    """What is asked for.

    Attributes:
        jobs: workers; None for as many as CPUs and memory allow, or as the cluster has.
        timeout_s: the longest one recording may take.
        settle_s: what was changed within so many seconds is left for later.
        newer_than_s: what was last changed before [s since 1970] is not begun.
        retry_failed: try again what failed and has not changed.
        collect: begin nothing; sum up what the shards have done.
        dask: address or scheduler file of the cluster that does the work; None for processes here.
        pool: recordings of one device are calibrated as one.
        borrow: what cannot be calibrated well may use coefficients of its device's other recordings.
    """

    where: Where
    request: Request
    jobs: int | None = None
    timeout_s: float | None = None
    settle_s: float = 0.0
    newer_than_s: float | None = None
    retry_failed: bool = False
    shard: Shard = WHOLE
    collect: bool = False
    dask: str | None = None
    pool: bool = False
    borrow: bool = False

    @property
    def out(self) -> Path:
        """Folder of the outputs."""
        return self.where.out

    @property
    def lock(self) -> Path:
        """What one run at a time holds."""
        return self.out / f"{self.shard.basename}.lock"

    def settings(self) -> dict[str, Any]:
        """All that decides the recordings' own results but the recordings and their layout files."""
        return {
            **self.request.effective_settings(self.request.options.layout),
            "integers": self.request.integers,
        }

    def all_settings(self) -> dict[str, Any]:
        """All that decides the results but the recordings and their layout files."""
        return {**self.settings(), "pool": self.pool, "borrow": self.borrow}

    @property
    def replacing(self) -> tuple[str, ...]:
        """The later rounds whose results may replace a recording's own."""
        return ((POOLED,) if self.pool else ()) + ((BORROW,) if self.borrow else ())

    def asked(self) -> str:
        """A hash of settings and version: an earlier entry with another no longer stands."""
        text = json.dumps([__version__, self.settings()], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def ledger_of(study: Study) -> Ledger:
    """What is remembered: the run's own entries, those of the shards, and for a shard those of the whole."""
    others = [*sorted(study.out.glob("study.*-of-*.ledger")), study.out / f"{WHOLE.basename}.ledger"]
    own = study.out / f"{study.shard.basename}.ledger"
    return Ledger(own, [path for path in others if path != own])

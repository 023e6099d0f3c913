"""What a study should do: `Study`, and `Shard` for a part of it."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.version import __version__
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies.discovery import Where

SLURM = "slurm"
POOL, POOLED, BORROW, PRIOR = "pool", "pooled", "borrow", "prior"
REPLACING = (POOLED, BORROW, PRIOR)
"""Rounds after that of the own results that may replace one."""


@dataclass(frozen=True, slots=True)
class Shard:
    """Part `index` (from 1) of `number`."""

    index: int = 1
    number: int = 1

    def owns(self, name: str) -> bool:
        """Whether a recording of this name is this shard's; no other recording decides on it."""
        digest = hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest()
        return int.from_bytes(digest[:8], "big") % self.number == self.index - 1

    @property
    def whole(self) -> bool:
        """Whether it is all of the study."""
        return self.number == 1

    @property
    def basename(self) -> str:
        """Of the summary, the ledger and the lock."""
        return "study" if self.whole else f"study.{self.index}-of-{self.number}"


def shard(text: str | None, environment: Mapping[str, str] = os.environ) -> Shard:
    """The shard that `--shard` means: `2/8`, or `slurm` for this task of a job array.

    Raises:
        UsageError: it is neither, or this is no task of a job array whose numbers rise by one.
    """
    if text is None:
        return Shard()
    if text == SLURM:
        return _slurm(environment)
    part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if part is None or not 1 <= int(part[1]) <= int(part[2]):
        raise UsageError(
            f"--shard {text} is not a part such as 2/8", hint="give I/N with I from 1 to N, or slurm"
        )
    return Shard(int(part[1]), int(part[2]))


def _slurm(environment: Mapping[str, str]) -> Shard:
    """Slurm's sbatch(1), "output environment variables": the array's task, its least and how many."""
    names = ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT")
    words = [environment.get(name, "") for name in names]
    if not all(word.isdecimal() for word in words):
        raise UsageError("--shard slurm works only in a job array", hint="submit it with sbatch --array")
    task, least, number = map(int, words)
    if not 0 <= task - least < number:
        raise UsageError("--shard slurm needs an array with consecutive task numbers", hint="use --array=1-N")
    return Shard(task - least + 1, number)


WHOLE = Shard()


@dataclass(frozen=True, slots=True)
class Study:
    """What is asked for.

    Attributes:
        jobs: workers; None for as many as CPUs and memory allow, or as the cluster has.
        timeout_s: the longest one recording may take.
        settle_s: files modified within this many seconds are skipped for now.
        newer_than_s: what was last changed before [s since 1970] is not begun.
        retry_failed: try again what failed and has not changed.
        collect: begin nothing; sum up what the shards have done.
        dask: address or scheduler file of the cluster that does the work; None for processes here.
        pool: recordings of one device are calibrated as one.
        borrow: what cannot be calibrated well may use coefficients of its device's other recordings.
        prior: kind of prior that is learnt from the own results, which are found with that of the request;
            None: these stay.
        takeover_s: a run of another host that was silent for so long has ended; None: that is not known.
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
    prior: str | None = None
    takeover_s: float | None = None

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
            **self.request.effective_settings(self.request.options.layout).as_json(),
            "integers": self.request.integers,
            **({"keep_refused": True} if self.request.keep_refused else {}),
        }

    @property
    def replacing(self) -> tuple[str, ...]:
        """The later rounds whose results may replace a recording's own."""
        wanted = ((POOLED, self.pool), (BORROW, self.borrow), (PRIOR, self.prior is not None))
        return tuple(name for name, given in wanted if given)

    def asked(self) -> str:
        """A hash of settings and version: an earlier entry with another no longer stands."""
        text = json.dumps([__version__, self.settings()], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

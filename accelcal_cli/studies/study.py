"""`Study`: the request for a study; `Shard`: a part of one."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.settings import DEFAULT, LEARNT_PRIORS
from accelcal_cli.core.version import __version__
from accelcal_cli.output.registry import content_sha256
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies.discovery import Where

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Executor
    from contextlib import AbstractContextManager

    ExecutorHolder = Callable[[], AbstractContextManager[Executor]]

SLURM = "slurm"
POOL, POOLED, BORROW, PRIOR = "pool", "pooled", "borrow", "prior"
REPLACING = (POOLED, BORROW, PRIOR)
"""Names of the rounds that may replace an own result."""


@dataclass(frozen=True, slots=True)
class Shard:
    """Part `index` (from 1) of `number`."""

    index: int = 1
    number: int = 1

    def owns(self, name: str) -> bool:
        """Return True if a recording of this name belongs to the shard; only the name decides.

        The sensors of a file, which are called `FILE [SENSOR]`, belong to the same.
        """
        folder, slash, file = name.rpartition("/")
        of_file = f"{folder}{slash}{file.partition(' [')[0]}"
        digest = hashlib.sha256(of_file.encode("utf-8", "surrogateescape")).digest()
        return int.from_bytes(digest[:8], "big") % self.number == self.index - 1

    @property
    def whole(self) -> bool:
        """True if it is the whole study."""
        return self.number == 1

    @property
    def basename(self) -> str:
        """Stem of the summary, the ledger and the lock."""
        return "study" if self.whole else f"study.{self.index}-of-{self.number}"


def shard(text: str | None, environment: Mapping[str, str] = os.environ) -> Shard:
    """Return the shard that `--shard` names: `2/8`, or `slurm` for this task of a job array.

    Raises:
        UsageError: it is neither, or this is not a task of a job array whose numbers rise by one.
    """
    if text is None:
        return Shard()
    if text == SLURM:
        return _slurm(environment)
    part = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if part is None or not 1 <= int(part[1]) <= int(part[2]):
        hint = "give I/N with I from 1 to N, or slurm"
        raise UsageError(f"--shard {text} is not a part such as 2/8", hint=hint)
    return Shard(int(part[1]), int(part[2]))


def chosen_shard(values: Mapping[str, Any]) -> Shard:
    """Return the shard that options name; raises UsageError for one with what is for the whole study."""
    for name in ("collect", "prune", "decisions", "html"):
        if values["shard"] and values[name]:
            hint = "give one of them" if name == "collect" else "give it to --collect, not to --shard"
            raise UsageError(f"--shard processes one part, --{name} is for the whole study", hint=hint)
    return shard(values["shard"])


def _slurm(environment: Mapping[str, str]) -> Shard:
    """Return the shard of a task of a job array (sbatch(1), "output environment variables")."""
    words = [environment.get(f"SLURM_ARRAY_TASK_{name}", "") for name in ("ID", "MIN", "COUNT")]
    if not all(word.isdecimal() for word in words):
        raise UsageError("--shard slurm works only in a job array", hint="submit it with sbatch --array")
    task, least, number = map(int, words)
    if not 0 <= task - least < number:
        raise UsageError("--shard slurm needs an array with consecutive task numbers", hint="use --array=1-N")
    return Shard(task - least + 1, number)


WHOLE = Shard()


@dataclass(frozen=True, slots=True)
class Study:
    """The request for a study.

    Attributes:
        jobs: number of workers of this machine; None for as many as CPUs and memory allow.
        timeout_s: longest time for one recording.
        settle_s: age below which a file is skipped for now.
        newer_than_s: time [s since 1970] before which a file must not have been changed last to be started.
        retry_failed: whether recordings that failed and have not changed are tried again.
        collect: whether to start nothing, and sum up what the shards have done.
        executor: returns what holds an executor, which finds the own results; None for own processes.
        in_process: whether this process does all the work that no executor does.
        pool: whether recordings of one device are calibrated as one.
        borrow: whether a recording that cannot be calibrated well may use coefficients of its device.
        prior: kind of prior that is learnt from the own results (which are found with the request's prior);
            None if they stay.
        prune: whether results whose recording is gone are removed.
        keep_teaching: whether recordings that people excluded lend, pool and teach like others.
        decisions: file of what people decided about recordings; None: decisions.csv in OUT, if it is there.
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
    executor: ExecutorHolder | None = None
    in_process: bool = False
    pool: bool = False
    borrow: bool = False
    prior: str | None = None
    prune: bool = False
    keep_teaching: bool = False
    decisions: Path | None = None

    @property
    def out(self) -> Path:
        """Folder of the outputs."""
        return self.where.out

    @property
    def lock(self) -> Path:
        """Path of the lock, which one run at a time holds."""
        return self.out / f"{self.shard.basename}.lock"

    def settings(self) -> dict[str, Any]:
        """Return all settings that decide the recordings' own results."""
        return {
            **self.request.effective_settings(self.request.options.layout).as_json(),
            "integers": self.request.integers,
            **({"keep_refused": True} if self.request.keep_refused else {}),
            **({} if self.request.registry is None else {"registry": content_sha256(self.request.registry)}),
        }

    @property
    def replacing(self) -> tuple[str, ...]:
        """Names of the asked rounds whose results may replace a recording's own."""
        wanted = ((POOLED, self.pool), (BORROW, self.borrow), (PRIOR, self.prior is not None))
        return tuple(name for name, asked in wanted if asked)

    def asked(self) -> str:
        """Return a hash of settings and version, with which alone an earlier entry is valid."""
        text = json.dumps([__version__, self.settings()], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def with_learnt_prior(study: Study) -> Study:
    """Return a study whose prior is learnt from the own results, if its request names one that is.

    Raises:
        UsageError: its rounds would use a device's other recordings twice, or cannot be pooled.
    """
    settings = study.request.recording_settings
    if study.pool and settings.profile != DEFAULT.profile:
        text = f"recordings calibrated with profile {settings.profile} cannot be pooled"
        raise UsageError(text, hint="omit --pool or --profile")
    learnt = settings.prior
    if learnt not in LEARNT_PRIORS:
        return study
    for option, chosen in (("--pool", study.pool), ("--borrow", study.borrow)):
        if chosen:
            text = f"--prior {learnt} does not go with {option}: both use a device's other recordings"
            raise UsageError(text, hint="omit one of them")
    request = replace(study.request, settings=replace(settings, prior=DEFAULT.prior))
    return replace(study, request=request, prior=learnt)

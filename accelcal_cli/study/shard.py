"""A study shared out among machines: each recording belongs to one shard, by its name alone."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from accelcal_cli.core.errors import UsageError

SLURM = "slurm"


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
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise UsageError(f"--shard {text} is not a part such as 2/8", hint="or use --shard slurm")
    return Shard(int(found[1]), int(found[2]))


def _slurm(environment: Mapping[str, str]) -> Shard:
    """Slurm's sbatch(1), "output environment variables": the array's task, its least and how many."""
    names = ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT")
    words = [environment.get(name, "") for name in names]
    if not all(word.isdecimal() for word in words):
        raise UsageError("--shard slurm is for a task of a job array", hint="submit it with sbatch --array")
    task, least, number = map(int, words)
    if not 0 <= task - least < number:
        raise UsageError("--shard slurm needs an array whose numbers rise by one", hint="use --array=1-N")
    return Shard(task - least + 1, number)

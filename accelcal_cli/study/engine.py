"""What carries out the tasks of a study: processes of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Protocol

Told = Callable[[float], None]
"""Called where the work is done with the part of its task that is done, 0 to 1."""

Work = Callable[[Any, Told], Any]
"""What is done with a task; a function of a module, and its task and answer can be pickled."""

Moved = Callable[[Any, float], None]
"""Called with a task and by how much more of it is done; less than 0 where it begins anew."""


@dataclass(frozen=True, slots=True)
class Ended:
    """One task that ended.

    Attributes:
        answer: what the work returned; None where the worker did not live to say.
        fault: what befell the worker, else None.
        again: whether the fault may lie in the machine and not in the task.
    """

    task: Any
    answer: Any = None
    fault: str | None = None
    again: bool = False


class Engine(Protocol):
    """Does tasks, several at a time; what befalls one befalls it alone."""

    def run(self, tasks: list[Any]) -> Generator[Ended, None, None]:
        """Do all tasks; yields each as it ends. Nothing is left running when the iteration is given up."""

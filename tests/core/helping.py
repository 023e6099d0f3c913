"""Programs for `test_helpers.py`, each in a process that may be forked: `python -m tests.core.helping NAME`.

Each prints what it found as JSON.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from accelcal_cli.core import helpers as module
from accelcal_cli.core.helpers import Helper, beside, helpers, shared_memory
from accelcal_cli.core.system import take_over_process

CALLER = os.getpid()


def where(job: int) -> tuple[int, bool]:
    """Ten times the job, and whether the caller's process did it."""
    return 10 * job, os.getpid() == CALLER


def taken(helper: Helper[int, Any], jobs: int) -> list[Any]:
    """The results of so many jobs, given before any is taken."""
    for job in range(jobs):
        helper.give(job)
    assert helper.waiting == jobs
    return [helper.take() for _ in range(jobs)]


def processes() -> list[int]:
    """Those that this one has started and not waited for (proc(5))."""
    return [int(one) for one in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()]


def several() -> Any:
    with helpers(where, 3) as helping:
        found = [taken(one, 4) for one in helping]
        started = processes()
    return {"found": found, "processes": len(set(started)), "left": len(processes())}


def memory() -> Any:
    """What either writes the other reads."""
    held = shared_memory(8)

    def work(_job: int) -> int:
        held[1] = held[0] + 1
        return held[1]

    held[0] = 41  # before there is a helper
    with helpers(work, 1) as (helper,):
        first = taken(helper, 1)
        held[0] = 99
        return [first, held[1], taken(helper, 1), held[1]]


def fails() -> Any:
    """What the work raises is raised in the caller, whichever process it befell."""
    found: list[Any] = []

    def work(job: int) -> int:
        if job == 1 or (job == 3 and os.getpid() != CALLER):
            raise MemoryError(f"no memory for {job}")
        return job

    with helpers(work, 1) as (helper,):
        for job in range(5):
            helper.give(job)
        for _ in range(5):
            try:
                found.append(helper.take())
            except MemoryError as error:
                found.append(str(error))
    return found


def killed() -> Any:
    """Before any job, amid them and when all are done: the caller does what is left."""
    found = []
    for after in range(5):
        with helpers(where, 1) as (helper,):
            (process,) = processes()
            for job in range(4):
                if job == after:
                    os.kill(process, signal.SIGKILL)
                    os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
                helper.give(job)
                assert helper.ready() or job != after
            if after == 4:
                os.kill(process, signal.SIGKILL)
            found.append([helper.take()[0] for _ in range(4)])
    return found


def descriptors() -> int:
    return len([*Path("/proc/self/fd").iterdir()])


def refused() -> Any:
    """A process that cannot be had."""

    def fork() -> int:
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    os.fork, before = fork, descriptors()
    for _ in range(3):
        with helpers(where, 2) as helping:
            found = [taken(one, 3) for one in helping]
    return [found, descriptors() - before]


def threaded() -> Any:
    """Beside another thread, and behind it."""
    ended = threading.Event()
    other = threading.Thread(target=ended.wait)
    other.start()
    beside = module.can_be_forked()
    with helpers(where, 1) as (helper,):
        found = taken(helper, 2)
    ended.set()
    other.join()
    while len([*module.TASKS.iterdir()]) > 1:  # it may still be ending
        time.sleep(0.001)
    return [beside, found, module.can_be_forked()]


def interrupted() -> Any:
    """Signals to all processes are the caller's to handle; a helper goes on until it is closed."""
    with helpers(where, 1) as (helper,):
        (process,) = processes()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(process, number)
        return taken(helper, 3)


def left_early() -> Any:
    """An error in the block: nothing stays, though a helper is at work."""
    with contextlib.suppress(KeyboardInterrupt), helpers(time.sleep, 2) as helping:
        started = processes()
        for one in helping:
            one.give(1000)
        raise KeyboardInterrupt
    return [len(started), [Path(f"/proc/{process}").exists() for process in started]]


def cut_off() -> Any:
    """A job that cannot be sent: whatever the helper was at is not finished behind the caller's back."""
    held = shared_memory(1)

    def work(job: int) -> int:
        if os.getpid() != CALLER:
            os.write(pipe[1], b".")
            time.sleep(0.2)
            held[0] = 1
        return job

    pipe = os.pipe()
    with helpers(work, 1) as (helper,):
        helper.give(0)
        os.read(pipe[0], 1)  # it is at work
        Connection.send = failing
        helper.give(1)
        left = processes()
        return [left, helper.lost, helper.ready(), helper.take(), helper.take(), held[0]]


def failing(_pipe: Connection, _job: Any) -> None:
    raise OSError(errno.ENOBUFS, "No buffer space available")


def interrupted_twice() -> Any:
    """Once in the block, and again as the helper is to be closed."""
    close, again = Connection.close, list[int]()

    def closed(pipe: Connection) -> None:
        if not again:
            again.append(1)
            os.kill(os.getpid(), signal.SIGINT)
        close(pipe)

    kept = []
    with contextlib.suppress(KeyboardInterrupt), helpers(where, 1) as helping:
        kept += helping  # so that nothing closes its pipe but the end of this process
        Connection.close = closed
        raise KeyboardInterrupt
    return [len(again), len(processes())]


def beside_a_block() -> Any:
    """A long call, one that raises, and one that is too short for a helper."""

    def raises() -> int:
        raise ValueError("of the call")

    with beside(lambda: where(4), long=True) as long:
        found = [len(processes()), *long()]
    with contextlib.suppress(ValueError), beside(raises, long=True) as raising:
        raising()
        found.append("not raised")
    with beside(lambda: where(5), long=False) as short:
        return [*found, len(processes()), *short()]


def orphaned() -> Any:
    """The caller is killed: its helpers end by themselves, and with them whoever reads this hears the end."""
    with helpers(where, 2) as helping:
        found = [taken(one, 1) for one in helping]
        sys.stdout.write(json.dumps(found))
        sys.stdout.flush()
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    if sys.argv[1] != "guest":
        take_over_process()
    json.dump(globals()["several" if sys.argv[1] == "guest" else sys.argv[1]](), sys.stdout)

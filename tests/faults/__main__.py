"""Rewrites the table of docs/reliability.md, never by a test: `python -m tests.faults [CALLS] [COMMAND...]`.

CALLS: how many calls of each operation fail in turn (3); 0 for all, which takes hours. COMMAND: the columns
that are found anew; all without.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from tests.faults.checks import Tried
from tests.faults.growing import trial_folder
from tests.faults.scenarios import SCENARIOS, Scenario
from tests.faults.shim import Runner, running
from tests.faults.table import COLUMNS, put, read


def main() -> None:
    """Try the faults, and tell what was not as it must be."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    wanted = sys.argv[2:] or COLUMNS
    tried = Tried({place: codes for place, codes in read().items() if place[2] not in wanted})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for quick in (False, True):
            with running(folder / str(quick), forked=quick) as runner:
                assert runner is not None, "needs Linux and a C compiler"
                for scenario in SCENARIOS:
                    if scenario.command in wanted and scenario.quick == quick:
                        _try(tried, scenario, folder / scenario.name, runner, most or None)
    put(tried.cells)
    sys.exit(len(tried.wrong) > 0)


def _try(tried: Tried, scenario: Scenario, folder: Path, runner: Runner, most: int | None) -> None:
    """Try the faults of one command, and say how many there were."""
    start, runs, struck, wrong = time.monotonic(), tried.runs, tried.struck, len(tried.wrong)
    tried.each(trial_folder(scenario, folder, runner), most)
    found = tried.wrong[wrong:]
    sys.stdout.write("".join(f"{line}\n" for line in found))
    sys.stdout.write(
        f"{scenario.name}: {tried.struck - struck} faults in {tried.runs - runs} runs, {len(found)} wrong, "
        f"{time.monotonic() - start:.0f} s\n"
    )
    sys.stdout.flush()


if __name__ == "__main__":
    main()

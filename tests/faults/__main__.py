"""Rewrites the table of docs/reliability.md, never by a test: `python -m tests.faults [CALLS] [COMMAND...]`.

CALLS: how many calls of each operation fail in turn (3); 0 for all, which takes hours. COMMAND: the columns
that are found anew; all without.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.faults.checks import ERRORS, Stage, faults
from tests.faults.scenarios import SCENARIOS
from tests.faults.shim import running
from tests.faults.table import COLUMNS, Cells, put, read


def main() -> None:
    """Try the faults, and tell what was not as it must be."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    wanted = sys.argv[2:] or COLUMNS
    cells: Cells = {place: codes for place, codes in read().items() if place[2] not in wanted}
    wrong = 0
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as runner:
        assert runner is not None, "needs Linux and a C compiler"
        for number, scenario in enumerate(SCENARIOS):
            if scenario.command in wanted:
                wrong += _tried(Stage(scenario, Path(folder) / str(number), runner), most or None, cells)
                sys.stdout.write(f"{scenario.name}: done\n")
                sys.stdout.flush()
    put(cells)
    sys.exit(wrong > 0)


def _tried(stage: Stage, most: int | None, cells: Cells) -> int:
    """Enter the exit codes of one command; returns how many runs were not as they must be."""
    wrong = 0
    for operation in ERRORS:
        for error, fault in faults(operation, stage.calls[operation], most):
            try:
                code = stage.strike(fault).ran.code
            except AssertionError as failure:
                wrong += 1
                sys.stdout.write(f"{stage.scenario.name}, {fault}: {failure}\n")
            else:
                cells.setdefault((operation, error, stage.scenario.command), set()).add(code)
    return wrong


if __name__ == "__main__":
    main()

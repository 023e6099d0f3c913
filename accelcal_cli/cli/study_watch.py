"""What is seen of a running study: its lines, what is said of them, and one bar for all."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exits
from accelcal_cli.cli.results import study_line
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.study.items import FAILED, Item
from accelcal_cli.study.work import Answer


class Told:
    """Prints what comes, and keeps the exit code of each recording."""

    def __init__(self, out: Path, values: dict[str, Any], stack: contextlib.ExitStack) -> None:
        self.codes: list[int] = []
        self._out = out
        self._values = values
        self._stack = stack
        self._bar: Any = None
        self._failed = 0

    def begin(self, items: Sequence[Item]) -> None:
        """See `Watch`; every round has its own bar."""
        if self._values["quiet"] or sys.stderr is None or not sys.stderr.isatty():
            return
        from tqdm import tqdm

        if self._bar is not None:
            self._bar.close()
        total = sum(item.size for item in items)
        self._bar = tqdm(total=total, unit="B", unit_scale=True, leave=False, file=sys.stderr)
        self._stack.callback(self._bar.close)
        self._todo, self._done = len(items), 0

    def moved(self, bytes_done: float) -> None:
        """See `Watch`."""
        if self._bar is not None:
            self._bar.update(bytes_done)

    def ended(self, item: Item, answer: Answer) -> None:
        """See `Watch`."""
        row = answer.entry.row
        assert row is not None
        self.codes.append(row["exit_code"])
        self._failed += row["outcome"] == FAILED
        with self._aside(fresh=not answer.up_to_date):
            self._print(item, row)
            self._comment(item, row, answer)

    def said(self, text: str) -> None:
        """See `Watch`."""
        if not self._values["quiet"]:
            with self._aside(fresh=False):
                exits.say(text)

    @contextlib.contextmanager
    def _aside(self, *, fresh: bool) -> Iterator[None]:
        """Lines above the bar, and the bar as it is after them."""
        if self._bar is None:
            yield
            return
        with self._bar.external_write_mode(file=sys.stderr):
            yield
        self._done += fresh
        self._bar.set_description(f"{self._done}/{self._todo} recordings, {self._failed} failed")

    def _print(self, item: Item, row: dict[str, Any]) -> None:
        if self._values["as_json"]:
            if row["outcome"] != FAILED:
                click.echo(_compact(item.job.report))
        elif not self._values["quiet"]:
            written = None if row["parquet"] is None else item.job.parquet
            click.echo(study_line(row, item.source, written))

    def _comment(self, item: Item, row: dict[str, Any], answer: Answer) -> None:
        name = printable(item.source)
        if row["outcome"] == FAILED:
            kept = "" if answer.trace is None else f"; please report it with {exits.keep_trace(answer.trace)}"
            text = row["message"] if name in row["message"] else f"{name}: {row['message']}"
            exits.say(f"{text}{kept}")
        elif row["outcome"] == Outcome.REFUSED:
            exits.say(f"{name}: refused: {row['message']}")
        if self._values["quiet"]:
            return
        for problem in answer.problems if self._values["verbose"] else answer.problems[:1]:
            exits.say(f"{name}: {problem}")


def _compact(report: Path) -> str:
    """A report in one line."""
    import json

    return json.dumps(json.loads(report.read_text("utf-8")))


@contextlib.contextmanager
def watching(out: Path, values: dict[str, Any]) -> Iterator[Told]:
    """A watcher whose bar is gone at the end."""
    with contextlib.ExitStack() as stack:
        yield Told(out, values, stack)

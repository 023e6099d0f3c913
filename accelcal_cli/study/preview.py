"""What a study would do."""

from __future__ import annotations

from dataclasses import replace

from accelcal_cli.core.errors import OutputError
from accelcal_cli.study.choice import Choice, rounds
from accelcal_cli.study.find import check
from accelcal_cli.study.items import Item, Standing
from accelcal_cli.study.plan import Study, ledger_of
from accelcal_cli.study.rounds import Known
from accelcal_cli.study.todo import plan


def preview(study: Study) -> dict[Item, str]:
    """What a run would do with each recording: `todo`, `waiting`, or the outcome that it has.

    What a later round does is decided by what is known now; nothing is locked or written.

    Raises:
        UsageError: see `plan`.
        OutputError: the output folder cannot be one.
    """
    check(study.where)
    there = next(path for path in (study.out, *study.out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise OutputError("cannot be made (there is a file)", path=there)
    ledger = ledger_of(study)
    found = plan(study, ledger)
    known = Known({item.name: Standing(item, entry, entry) for item, entry in found.done})
    states = dict.fromkeys(found.todo, "todo") | dict.fromkeys(found.waiting, "waiting")
    choice = Choice(study, ledger, found.changing)
    for one in rounds(study):
        todo, taken = choice.of(one, one.tasks(study, known))
        states |= {known.standing[name].item: "todo" for task in todo for name in task.names}
        for task, entry in taken:
            if one.of_pools:
                known.pools[task.item.name] = entry
            else:
                known.standing[task.item.name] = replace(known.standing[task.item.name], last=entry)
    rest = {
        one.item: (one.last.row or {})["outcome"] for one in known.standing.values() if not one.item.aside
    }
    return rest | states

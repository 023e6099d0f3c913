"""A study whose times are not of one type says so."""

from __future__ import annotations

import pytest

from accelcal_cli.studies.findings import as_json, lines, of_times
from accelcal_cli.studies.summary import Summary


def rows(*zones: str | None) -> list[dict[str, str | None]]:
    row = {"outcome": "calibrated", "model": "9", "parquet": "a.parquet"}
    return [{**row, "time_zone": zone} for zone in zones]


@pytest.mark.parametrize(
    ("zones", "counts"),
    [(("UTC", "UTC"), {"UTC": 2}), (("unknown",), {"unknown": 1}), ((None,), {}), ((), {})],
)
def test_times_of_one_type_need_no_word(zones: tuple[str | None, ...], counts: dict[str, int]) -> None:
    table = [*rows(*zones), {"outcome": "refused", "model": None, "parquet": None, "time_zone": "unknown"}]
    assert (Summary(table, {}).counts()["time_zones"], [*of_times(table)]) == (counts, [])


def test_mixed_times_are_told_with_the_way_out() -> None:
    table = rows("UTC", "unknown", "UTC")
    assert Summary(table, {}).counts()["time_zones"] == {"UTC": 2, "unknown": 1}
    (found,) = of_times(table)
    start = "Times are in UTC in 2 Parquet files, and in local time of an unknown zone in 1 "
    assert found.line.startswith(start) and "--timezone" in found.line


def test_a_quiet_run_tells_of_mixed_times_once() -> None:
    """Not again with each recording that is added."""
    first, later = list(of_times(rows("UTC", "unknown"))), list(of_times(rows("UTC", "unknown", "UTC")))
    last = {"findings": as_json(first)}
    assert list(lines(later, last)) == [(later[0].line, False)]
    assert first[0].line != later[0].line and list(lines(later, {})) == [(later[0].line, True)]

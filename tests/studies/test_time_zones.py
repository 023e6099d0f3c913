"""A study whose times are not of one type says so."""

from __future__ import annotations

import pytest

from accelcal_cli.studies.summary import Summary


def rows(*zones: str | None) -> list[dict[str, str | None]]:
    return [
        {"outcome": "calibrated", "model": "9", "parquet": "a.parquet", "time_zone": zone} for zone in zones
    ]


@pytest.mark.parametrize(
    ("zones", "counts"),
    [(("UTC", "UTC"), {"UTC": 2}), (("unknown",), {"unknown": 1}), ((None,), {}), ((), {})],
)
def test_times_of_one_type_need_no_word(zones: tuple[str | None, ...], counts: dict[str, int]) -> None:
    content = Summary(rows(*zones), {}).counts()
    assert (content["time_zones"], content["mixed_times"]) == (counts, None)


def test_mixed_times_are_told_with_the_way_out() -> None:
    content = Summary(rows("UTC", "unknown", "UTC"), {}).counts()
    assert content["time_zones"] == {"UTC": 2, "unknown": 1}
    assert content["mixed_times"].startswith(
        "Times are in UTC in 2 Parquet files, and in local time of an unknown zone in 1 "
    )
    assert "--timezone" in content["mixed_times"]


def test_what_wrote_no_parquet_is_not_counted() -> None:
    refused = {"outcome": "refused", "model": None, "parquet": None, "time_zone": "unknown"}
    assert Summary([*rows("UTC"), refused], {}).mixed_times() is None


def test_a_quiet_run_tells_of_mixed_times_once() -> None:
    first = Summary(rows("UTC", "unknown"), {})
    (said,) = first.news(repeat=False)
    later = Summary(rows("UTC", "unknown", "UTC"), {}, before=first.counts())
    assert (list(later.news(repeat=False)), list(later.news(repeat=True))) == ([], [later.mixed_times()])
    assert said == first.mixed_times()

"""Times of recordings in memory: of the zone that they state, whatever library holds them; none is lost."""

from __future__ import annotations

import datetime as dt
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import accelcal
from tests.test_python_memory import CELSIUS, FRAME, NUMBER, TIMES, XYZ

BERLIN = pd.DatetimeIndex(TIMES).tz_localize("Europe/Berlin")
AXES = dict(zip("xyz", XYZ.T, strict=True))
OFFSET = dt.timezone(dt.timedelta(hours=1))
PLAIN = accelcal.calibrate(FRAME)

ZONED: dict[str, Any] = {
    "index": BERLIN,
    "series": pd.Series(BERLIN),
    "datetimes": BERLIN.to_pydatetime().tolist(),
    "stamps": list(BERLIN),
    "objects": np.array(BERLIN.to_pydatetime(), object),
    "polars": pl.Series(BERLIN),
    "arrow": pa.array(BERLIN),
    "chunks": pa.chunked_array([pa.array(BERLIN[:1000]), pa.array(BERLIN[1000:])]),
}
NAIVE: dict[str, Any] = {
    "periods": pd.Series(TIMES).dt.to_period("us"),
    "index": pd.DatetimeIndex(TIMES),
    "datetimes": TIMES.tolist(),
    "stamps": list(pd.DatetimeIndex(TIMES)),
    "polars": pl.Series(TIMES),
    "arrow": pa.array(TIMES),
    "texts": TIMES.astype(str).tolist(),
}


def of_array(times: Any, **options: Any) -> accelcal.Result:
    return accelcal.calibrate(XYZ, time=times, temperature=CELSIUS, **options)


def of_columns(times: Any, **options: Any) -> accelcal.Result:
    return accelcal.calibrate({"time": times, "accel": XYZ, "temperature": CELSIUS}, **options)


def of_frame(times: Any, **options: Any) -> accelcal.Result:
    times = times if isinstance(times, list | pd.Series | pd.Index | np.ndarray) else times.to_pandas()
    frame = pd.DataFrame({**AXES, "temperature": CELSIUS}, index=pd.Index(times))
    return accelcal.calibrate(frame, **options)


def start(result: accelcal.Result) -> tuple[str, str | None, int]:
    about = result["recording"]
    return about["start_time"], about["timezone"], about["samples"]


@pytest.mark.parametrize("call", [of_array, of_columns, of_frame])
@pytest.mark.parametrize("kind", ZONED)
def test_times_are_of_the_zone_that_they_state(call: Any, kind: str) -> None:
    found = call(ZONED[kind])
    assert start(found) == ("2024-03-04T00:00:00.000000+01:00", "Europe/Berlin", NUMBER)
    index = found.to_pandas().index
    assert (index == BERLIN).all() and str(index.tz) == "UTC"
    assert found["calibration"]["gain"] == PLAIN["calibration"]["gain"]


@pytest.mark.parametrize("call", [of_array, of_columns, of_frame])
@pytest.mark.parametrize("kind", NAIVE)
def test_times_without_a_zone_are_the_devices_clock(call: Any, kind: str) -> None:
    assert start(call(NAIVE[kind])) == ("2024-03-04T00:00:00.000000", None, NUMBER)
    zoned = call(NAIVE[kind], timezone="Europe/Berlin")
    assert start(zoned) == ("2024-03-04T00:00:00.000000+01:00", "Europe/Berlin", NUMBER)


@pytest.mark.parametrize(
    ("zone", "starts", "named"),
    [
        (OFFSET, "2024-03-04T00:00:00.000000+01:00", "+01:00"),
        (dt.UTC, "2024-03-03T23:00:00.000000+00:00", "UTC"),
        (ZoneInfo("Asia/Kolkata"), "2024-03-04T04:30:00.000000+05:30", "Asia/Kolkata"),
        (ZoneInfo("Europe/London"), "2024-03-03T23:00:00.000000+00:00", "Europe/London"),
    ],
)
def test_every_zone_keeps_its_name(zone: Any, starts: str, named: str) -> None:
    times = BERLIN.tz_convert(zone)
    for found in (of_array(times.to_pydatetime().tolist()), of_columns(pd.Series(times)), of_frame(times)):
        assert start(found) == (starts, named, NUMBER)


def test_a_zone_of_the_user_counts_unless_it_contradicts() -> None:
    for zone in ("Europe/Berlin", "Europe/Paris", "+01:00"):
        assert start(of_frame(BERLIN, timezone=zone))[:2] == (
            "2024-03-04T00:00:00.000000+01:00", "Europe/Berlin",
        )  # fmt: skip
    with pytest.raises(accelcal.AccelcalError, match="Europe/Berlin, which is not America/New_York"):
        of_frame(BERLIN, timezone="America/New_York")
    worn = of_frame(BERLIN, worn_zone="America/New_York")
    assert start(worn)[:2] == ("2024-03-03T18:00:00.000000-05:00", "America/New_York")


def test_values_that_went_out_come_in_at_the_same_moments() -> None:
    for raw in (PLAIN.to_pandas(), accelcal.read(FRAME).to_pandas()):
        assert raw.index.tz is None and (raw.index == TIMES).all()
    values = of_frame(BERLIN).to_pandas()
    with accelcal.read(FRAME, timezone="Europe/Berlin") as reading:
        for frame in (values, accelcal.read(values).to_pandas(), reading.to_pandas()):
            assert (frame.index == BERLIN).all() and str(frame.index.tz) == "UTC"
            assert start(accelcal.calibrate(frame))[0] == "2024-03-03T23:00:00.000000+00:00"
        assert (reading.to_polars()["time"].to_numpy() == TIMES - np.timedelta64(1, "h")).all()
        local = reading.to_pandas(local=True).index
    for index in (local, of_frame(BERLIN).to_pandas(local=True).index):
        assert (index == BERLIN).all() and str(index.tz) == "Europe/Berlin"
    assert PLAIN.to_pandas(local=True).index.tz is None


@pytest.mark.parametrize(
    ("begins", "starts", "named"),
    [
        ("2024-03-30T23:40", "2024-03-31T00:40:00.000000+01:00", "Europe/Berlin"),  # an hour is skipped
        ("2024-10-26T23:40", "2024-10-27T01:40:00.000000+02:00", "Europe/Berlin"),  # an hour comes twice
        ("2024-10-27T01:10", "2024-10-27T02:10:00.000000+01:00", "+01:00"),  # within it, the second time
    ],
)
def test_moments_run_on_where_clocks_are_put_forward_or_back(begins: str, starts: str, named: str) -> None:
    moments = pd.DatetimeIndex(TIMES - TIMES[0] + np.datetime64(begins, "us"), tz="UTC")
    found = of_frame(moments.tz_convert("Europe/Berlin"))
    assert start(found) == (starts, named, NUMBER) and not found["recording"]["gaps"]
    assert (found.to_pandas().index == moments).all()


def test_a_rate_does_not_replace_times_and_a_gap_stays() -> None:
    late = BERLIN[:20_000].append(BERLIN[20_000:] + pd.Timedelta(seconds=12_000))
    for found in (of_array(late.to_pydatetime().tolist(), rate=25), of_frame(late, rate=25)):
        assert [one["seconds"] for one in found["recording"]["gaps"]] == [12_000.04]
        assert (found.to_pandas().index == late).all()


@pytest.mark.parametrize("call", [of_array, of_columns, of_frame])
def test_times_of_which_some_have_a_zone_are_asked_for(call: Any) -> None:
    mixed = [*TIMES[:10].tolist(), *BERLIN[10:].to_pydatetime()]
    with pytest.raises(accelcal.AccelcalError, match="have a zone and some do not; give all of them one"):
        call(np.array(mixed, object))


def test_what_is_masked_is_empty() -> None:
    mask = np.zeros(XYZ.shape, np.bool_)
    mask[20_000:24_000] = True
    masked, counts = np.ma.masked_array(XYZ + 5 * mask, mask), np.ma.masked_array(CELSIUS, mask[:, 0])
    frame = FRAME.astype({"x": "Float64"})
    frame.loc[20_000:23_999, "x"] = None
    tables = [{"time": TIMES, "accel": masked}, {"time": list(BERLIN), "accel": masked}, frame]
    arrays = [accelcal.calibrate(masked, time=TIMES, temperature=one) for one in (CELSIUS, counts)]
    for found in [*arrays, *map(accelcal.calibrate, tables)]:
        assert found["recording"]["samples"] == NUMBER - 4000
        assert [one["seconds"] for one in found["recording"]["gaps"]] == [160.04]
    whole = accelcal.calibrate(np.ma.masked_array((1000 * XYZ).round().astype(int)), rate=25, unit="mg")
    assert whole["recording"]["samples"] == NUMBER
    stamps = np.ma.masked_array(TIMES, mask[:, 0])
    assert accelcal.calibrate(XYZ, time=stamps)["recording"]["samples"] == NUMBER - 4000


@pytest.mark.parametrize("name", ["file", "allow_pickle", "who"])
def test_a_column_may_have_any_name_and_any_objects(name: str) -> None:
    plain: dict[str, Any] = {column: FRAME[column].to_numpy() for column in FRAME}
    texts = [number if number % 3 else f"note {number}" for number in range(NUMBER)]
    ragged = [[number] * (number % 3) for number in range(NUMBER)]
    for values in (np.arange(NUMBER), np.array(texts, object), ragged):
        found = accelcal.calibrate(plain | {name: values})
        assert found["calibration"] == PLAIN["calibration"]
    assert accelcal.calibrate(FRAME.assign(who=texts))["calibration"] == PLAIN["calibration"]
    single = accelcal.calibrate({"time": BERLIN, "accel": XYZ.T, "serial": "A1", "range_g": 8})
    assert (single["recording"]["device"]["serial"], single["recording"]["range_g"]) == ("A1", 8.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_shuffled_table_is_to_be_sorted(seed: int) -> None:
    shuffled = FRAME.sample(frac=1, random_state=seed)
    for table in (shuffled, shuffled.set_index("time"), pl.from_pandas(shuffled), shuffled.to_csv().encode()):
        with pytest.raises(accelcal.AccelcalError, match=r"not in the order of their times; sort its rows"):
            accelcal.calibrate(table)
    assert accelcal.calibrate(shuffled.sort_values("time"))["calibration"] == PLAIN["calibration"]

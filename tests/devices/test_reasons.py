"""The rules of `devices/review.py`, each with a device that it is meant for and one that it is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import special

from accelcal_cli.devices.review import DeviceReview
from accelcal_cli.output.sentences import of_device
from tests.devices.made import drifting, fitted, good_devices, refused, reviewed


def told(unit: DeviceReview) -> list[tuple[str, bool]]:
    found = [one for one in unit.findings if one.verdict != "unknown"]
    return [(one.reason.code, one.verdict == "service") for one in found]


def said(unit: DeviceReview) -> str:
    return of_device(unit.findings[0].reason)


def test_a_good_fleet_is_good(tmp_path: Path) -> None:
    found = reviewed(tmp_path, good_devices(12))
    assert [str(unit.verdict) for unit in found.values()] == ["good"] * 12
    assert list(found) == sorted(found)


def test_a_known_drift_is_found(tmp_path: Path) -> None:
    found = reviewed(tmp_path, [*good_devices(), *drifting("D", 0.005), *drifting("slow", 0.001)])
    (x,) = [one for one in found["D"].trends if one.parameter.name == "offset_x"]
    assert x.drift is not None
    assert abs(x.drift.per_month - 5.0) < 3 * x.drift.error
    days = 30.0 * np.arange(8)
    assert x.drift.error == pytest.approx(
        0.1 / np.sqrt(((days - days.mean()) ** 2).sum()) * 30.4375 * max(1, x.drift.scatter) ** 0.5
    )
    assert told(found["D"]) == [("device_drift", True)]
    assert found["D"].verdict == "service"
    assert said(found["D"]) == "offset x drifts by +4.990 +- 0.016 mg a month"
    assert told(found["slow"]) == []
    assert next(iter(found)) == "D"


@pytest.mark.parametrize(
    ("name", "per_month", "label"),
    [("k_yy", 0.004, "scale y"), ("k_zx", -0.004, "misalignment zx"), ("offset_z_g", -0.004, "offset z")],
)
def test_each_kind_drifts_in_its_unit(tmp_path: Path, name: str, per_month: float, label: str) -> None:
    unit = reviewed(tmp_path, drifting("D", per_month, name=name))["D"]
    assert told(unit) == [("device_drift", True)]
    size = per_month * (1000 if name.startswith("offset") else 100)
    text = said(unit).removeprefix(f"{label} drifts by ")
    assert float(text.split()[0]) == pytest.approx(size, rel=0.02)


def test_few_recordings_make_no_drift_certain(tmp_path: Path) -> None:
    """With one degree of freedom even a drift of 40 standard errors has a probability of 1.6 %."""
    noisy = [fitted("C", 30.0 * n, {"offset_x_g": 0.004 * n + 0.001 * (n == 1)}) for n in range(3)]
    found = reviewed(tmp_path, [*drifting("A", 0.005, 2), *drifting("B", 0.005, 3), *noisy])
    assert [one.drift for one in found["A"].trends] == [None] * 9
    assert told(found["C"]) == []
    assert told(found["B"]) == [("device_drift", False)]
    assert found["B"].verdict == "watch"


def test_significance_is_corrected_for_the_number_of_parameters(tmp_path: Path) -> None:
    """The limit lies between the drifts of two devices that differ in nothing else."""
    freedom, tested = 6, 9
    limit = -special.stdtrit(freedom, special.ndtr(-3) / tested)
    error = 0.1 / np.sqrt((days := 30.0 * np.arange(8) - 105) @ days) * 30.4375
    rows = []
    for serial, factor in (("above", 1.01), ("below", 0.99)):
        slope = factor * limit * error / 1000 / 30.4375
        rows += [fitted(serial, 30.0 * n, {"offset_x_g": slope * 30 * n}) for n in range(8)]
    found = reviewed(tmp_path, rows, drift_mg=0.01)
    assert told(found["above"]) == [("device_drift", True)]
    assert told(found["below"]) == [("device_drift", False)]


def test_levels_beyond_the_limits(tmp_path: Path) -> None:
    rows = [fitted("A", 0, {"offset_z_g": -0.151}), fitted("B", 0, {"offset_z_g": 0.1499}),
            fitted("C", 0, {"k_xx": 1.11, "k_yx": 0.12}), fitted("D", 0, {"offset_z_g": 0.1501})]  # fmt: skip
    found = reviewed(tmp_path, rows)
    assert {name: told(unit) for name, unit in found.items()} == {
        "A": [("device_level", True)],
        "B": [],
        "C": [("device_level", True)] * 2,
        "D": [("device_level", False)],
    }
    assert said(found["A"]) == "offset z is -151.00 +- 0.10 mg (limit 150 mg)"
    assert said(found["C"]) == "misalignment yx is +12.000 +- 0.010 % (limit 10 %)"


def test_an_outlying_held_out_error(tmp_path: Path) -> None:
    bad = [fitted("bad", 30.0 * number, after_mg=6.0) for number in range(2)]
    once = [fitted("once", 0, after_mg=6.0)]
    found = reviewed(tmp_path, [*good_devices(8), *bad, *once])
    assert told(found["bad"]) == [("device_held_out", True)]
    assert told(found["once"]) == [("device_held_out", False)]
    assert said(found["bad"]) == "held-out error 6.0 mg (similar devices: 2.1 mg)"
    assert told(reviewed(tmp_path, [*good_devices(3), *bad])["bad"]) == []
    assert (
        told(reviewed(tmp_path, [*good_devices(8), *(row | {"format": "csv"} for row in bad)])["bad"]) == []
    )


@pytest.mark.parametrize(
    ("others", "limit"), [((1, 2, 3, 4, 5, 6), 4 + 5 * 1.4826 * 2), ((2, 2, 2, 2, 2, 2), 2 + 5 * 0.5)]
)
def test_usual_is_the_median_and_its_deviation(tmp_path: Path, others: tuple[int, ...], limit: float) -> None:
    """Of seven errors, the last beyond the others: the median distance is the fourth, but at least 0.5 mg."""
    rows = [fitted(f"{number}", 0, after_mg=float(error)) for number, error in enumerate(others)]
    for error, found in ((limit - 0.01, []), (limit + 0.01, [("device_held_out", False)])):
        assert told(reviewed(tmp_path, [*rows, fitted("x", 0, after_mg=error)])["x"]) == found


def test_slopes_have_limits_of_level_and_drift(tmp_path: Path) -> None:
    """5 mg/C, and 2 mg over 10 C a month; standard errors are 0.01 mg/C."""
    rows = [
        fitted(name, 0, {"slope_y_g_per_c": size}, model="9T")
        for name, size in (("steep", -0.0051), ("flat", 0.0049))
    ]
    for name, size in (("moves", 0.00021), ("stays", 0.00019)):
        rows += [
            fitted(name, 30.4375 * n, {"slope_y_g_per_c": size * n - 0.001}, model="9T") for n in range(8)
        ]
    found = reviewed(tmp_path, rows)
    assert {name: told(unit) for name, unit in found.items()} == {
        "steep": [("device_level", True)], "flat": [], "moves": [("device_drift", True)], "stays": [],
    }  # fmt: skip
    assert said(found["moves"]).startswith("slope y drifts by +0.2100 +- ")


@pytest.mark.parametrize(("lost", "reasons"), [(0.09, []), (0.1, [("device_damaged", True)])])
def test_a_little_damage_is_none(tmp_path: Path, lost: float, reasons: list[tuple[str, bool]]) -> None:
    rows = [*good_devices(2), *(fitted("x", 30.0 * number, lost_percent=lost) for number in range(2))]
    assert told(reviewed(tmp_path, rows)["x"]) == reasons


def test_repeated_refusals_and_damage(tmp_path: Path) -> None:
    odd = [refused("odd", 30.0 * number, orientations=20) for number in range(3)]
    rows = [*good_devices(4), *odd, fitted("odd", 99), refused("once", 0, orientations=20)]
    rows += [fitted("wet", 30.0 * number, lost_percent=3.0 * number) for number in range(4)]
    found = reviewed(tmp_path, rows)
    assert told(found["odd"]) == [("device_refused", True)]
    assert said(found["odd"]) == "3 of 4 recordings refused or borrowed (other devices: 3 %)"
    assert (told(found["once"]), found["once"].verdict) == ([], "unknown")
    assert told(found["wet"]) == [("device_damaged", True)]
    assert "damage in 3 of 4 recordings, up to 9 % lost" in said(found["wet"])


def test_where_all_are_refused_no_device_is_to_blame(tmp_path: Path) -> None:
    rows = [refused(serial, 30.0 * number, orientations=20) for serial in "ABC" for number in range(3)]
    found = reviewed(tmp_path, rows)
    assert {str(unit.verdict) for unit in found.values()} == {"unknown"}


def test_all_limits_can_be_moved(tmp_path: Path) -> None:
    rows = [*drifting("D", 0.005), fitted("L", 0, {"offset_z_g": 0.2})]
    assert {str(one.verdict) for one in reviewed(tmp_path, rows).values()} == {"service"}
    moved = reviewed(tmp_path, rows, drift_mg=6.0, offset_mg=250.0)
    assert {str(one.verdict) for one in moved.values()} == {"good"}
    assert [one.drift for one in reviewed(tmp_path, rows, least_days=300)["D"].trends] == [None] * 9

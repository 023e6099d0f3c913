"""What a report says to people beside its verdict: what speaks against trusting a result, and what to do.

Sentences for the terminal and for pages. All of them follow from the report; nothing is judged here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from accelcal_cli.core.errors import counted, listed
from accelcal_cli.core.settings import DEFAULT

Report = Mapping[str, Any]

LIMIT_MG = DEFAULT.max_error_mg
"""What the 95 % interval of a good result stays below, where a report's settings do not say."""

MIN_POSTURES = 9
"""More are not what a recording lacks, unless they leave out a side."""

OF_ANOTHER = (
    "Coefficients of the device's other recordings may do: study --borrow, --pool device or --prior device, "
    "or apply; so may a session on six faces (six-pose)."
)
BY_OTHERS = "Stillness that another tool has found can be fitted, too: accelcal fit."
UNIT = (
    "Say what the values are: --unit, or --lsb-per-g for counts; --columns for a table; "
    "the fields of the layout file for a dump."
)
UNCHECKED = (
    "Nothing was held out: no error is known, and a pose that is wrong would not show. "
    "Add poses, or roll the device with one axis level (six-pose --roll)."
)
UNCHECKED_ROLLED = "Nothing was held out: what the roll shows is all that speaks for it."
RIGHT_G = (0.7, 1.4)
"""Between these is the median of |a| at rest [g] if unit and scale are right."""


def cautions(report: Report) -> tuple[str, ...]:
    """What speaks against trusting a result without a look."""
    everywhere = report.get("sphere_mg") is not None
    found = [*filter(None, [unchecked_poses(report)]), *doubts(*_interval(report), everywhere=everywhere)]
    change = report.get("change") or {"kind": "none"}
    calibration = report["calibration"] or {}
    if change["kind"] != "none" and calibration.get("course") is None:
        found.append(
            "The sensor changed while it recorded, and the calibration does not follow it: "
            "see the error by the hour."
        )
    elif change["kind"] != "none":
        found.append(
            "The sensor changed while it recorded; the calibration follows it. Have the device checked."
        )
    if any(one["found"] for one in report.get("misfits") or ()):
        found.append(
            "The sensor does something that coefficients cannot put right (docs/misfit.md): "
            "have the device checked."
        )
    if report["coverage"].get("saturated"):
        found.append("An axis stops measuring short of its range: have the device checked.")
    return tuple(found)


def _interval(report: Report) -> tuple[float | None, float | None, float]:
    """Upper end of the 95 % interval of the error, the error before, and the limit [mg]."""
    sphere, holdout = report.get("sphere_mg"), report["holdout"]
    limit = setting(report, "max_error_mg", LIMIT_MG)
    if report["outcome"] == "already_good":
        return (None if sphere is None else sphere["ci95"][1]), None, limit
    if sphere is not None:
        return sphere["ci95"][1], sphere["before"], limit
    if holdout is not None:
        return holdout["ci95_mg"][1], holdout["before_mg"]["mean"], limit
    return None, None, limit


def doubts(
    high: float | None, before: float | None, limit: float = LIMIT_MG, *, everywhere: bool = True
) -> list[str]:
    """What a 95 % interval says against a result [mg].

    Args:
        high: its upper end; before: the error of the raw values, where there is one to compare with.
        everywhere: it is of the whole sphere, not of the recording's own postures only.
    """
    if high is None:
        return []
    found = []
    if high >= limit:
        where = "in postures that are not in the recording" if everywhere else "on average"
        found.append(f"The error may reach {_mg(high)} {where}: do not rely on it where a few mg matter.")
    if before is not None and high >= before:
        found.append(
            f"This may be no better than the raw values: their {_mg(before)} lie within the interval."
        )
    return found


def _mg(value: float) -> str:
    return f"{value:.0f} mg" if value >= 100 else f"{value:.3g} mg"


def unchecked_poses(report: Report) -> str | None:
    """That nothing speaks for a calibration from known orientations; None where something does."""
    known = report.get("known_orientations") or {}
    if "unchecked" not in known or report["calibration"] is None:
        return None
    return UNCHECKED_ROLLED if known.get("rolls") else UNCHECKED


def unchecked(report: Report) -> str | None:
    """The sides on which a calibrated device never rested; None if it rested on all."""
    faces = _faces(report) if report["coverage"]["cells"] else []
    if report["calibration"] is None or not faces:
        return None
    return f"It never rested with {listed(faces)} pointing up: what it measures there was not checked."


def ways_on(report: Report) -> tuple[str, ...]:
    """What would make a refused recording one that can be used, as far as the report tells."""
    health, coverage = report["file_health"], report["coverage"]
    if (health.get("lost_percent") or 0) > setting(report, "max_damage_percent", 100.0):
        return ()  # the message says all
    rest = health.get("rest")
    if rest and not RIGHT_G[0] < rest["median_g"] < RIGHT_G[1]:
        return (UNIT,)
    if report["settings"].get("input", {}).get("format") == "points":
        return _postures(report) if coverage["cells"] else ()
    if not coverage["cells"]:
        again = "Record again: the device has to lie still for some seconds, in different postures."
        return again, BY_OTHERS, OF_ANOTHER
    return (*_postures(report), OF_ANOTHER)


def _postures(report: Report) -> tuple[str, ...]:
    """Which postures are missing."""
    said, faces = [], _faces(report)
    number = report["coverage"].get("distinct_orientations")
    if number is not None and (faces or number < setting(report, "min_postures", MIN_POSTURES)):
        said.append(
            f"Stillness was found in {counted(number, 'posture')}. "
            "More turns of the wrist, and a longer recording, help."
        )
    if faces:
        side = "that side" if len(faces) == 1 else "each of these sides"
        said.append(
            f"The device never rested with {listed(faces)} pointing up. "
            f"Take it off and leave it for a minute on {side}."
        )
    return tuple(said)


def _faces(report: Report) -> list[str]:
    """Directions of axes, such as `-z`, that no point comes near."""
    coverage, reach = report["coverage"], setting(report, "coverage_g", 0.3)
    return [
        f"{sign}{axis}"
        for axis, low, high in zip("xyz", coverage["axis_min_g"], coverage["axis_max_g"], strict=True)
        for sign, there in (("-", low <= -reach), ("+", high >= reach))
        if not there
    ]


def setting(report: Report, name: str, default: float) -> float:
    """A number among the settings; the usual one where a report has none."""
    value = report["settings"].get(name)
    return value if type(value) in (int, float) else default

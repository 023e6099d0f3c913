"""What one recording's page says in words: the verdict, what to do, and a paragraph on methods.

Everything follows from the report; nothing is judged here that the report has not judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from accelcal_cli.core.errors import counted
from accelcal_cli.output import advice
from accelcal_cli.pages.svg import number

Level = Literal["good", "care", "bad"]
Report = Mapping[str, Any]

CITATION = (
    "Farago, Maczak, Gingl (2024): Enhancing Accuracy in Actigraphic Measurements. IEEE Access; "
    "the procedure as implemented in accelcal {version}."
)
MEANINGS = {
    **{f"k_{axis}{axis}": f"scale of {axis}" for axis in "xyz"},
    **{f"k_{row}{of}": f"misalignment: {of} in {row}" for row in "xyz" for of in "xyz" if row != of},
    **{f"o{axis}": f"offset of {axis} [g]" for axis in "xyz"},
    **{f"s{axis}": f"change of the offset of {axis} [g per °C]" for axis in "xyz"},
}
MODELS = {
    "0": "no correction",
    "3": "offsets",
    "6": "scales and offsets",
    "9": "scales, misalignments and offsets",
    "12": "the full gain matrix and offsets",
}
OPENING = {
    "calibrated": "calibrated",
    "reduced_model": "calibrated in part",
    "already_good": "good as it is, no correction needed",
    "borrowed": "calibrated with another recording's coefficients",
}
TO_DO = {
    "calibrated": "Use the calibrated recording.",
    "reduced_model": "Use the calibrated recording; the reason says which corrections were left out.",
    "already_good": "Use the recording as it is: its raw values are no worse than calibrated ones would be.",
    "borrowed": "Compare the errors before and after, on its own still windows, before you use it.",
    "refused": "Do not use this recording as calibrated; no calibrated data were written.",
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """What comes first on the page.

    Attributes:
        headline: one sentence; reason: the report's message; to_do: what to do, a sentence each.
    """

    level: Level
    headline: str
    reason: str
    to_do: tuple[str, ...]


def verdict(report: Report) -> Verdict:
    """The verdict on a recording."""
    outcome, cautions = report["outcome"], advice.cautions(report)
    if outcome == "refused":
        headline = "Refused: this recording could not be calibrated."
        return Verdict("bad", headline, report["message"], (TO_DO[outcome], *advice.ways_on(report)))
    good = not cautions and outcome != "borrowed"
    opening = f"{'Good' if good else 'Use with care'}: {OPENING[outcome]}"
    return Verdict(
        "good" if good else "care",
        f"{opening}. {_error(report)}",
        report["message"],
        (TO_DO[outcome], *cautions, *filter(None, (advice.unchecked(report),))),
    )


def _error(report: Report) -> str:
    """The number to quote, in a sentence."""
    sphere, holdout = report.get("sphere_mg"), report["holdout"]
    vectors = report.get("known_orientations")
    if sphere is not None:
        low, high = sphere["ci95"]
        return (
            f"Error over the whole sphere {number(sphere['mean'], 2)} mg "
            f"(95 % interval {number(low, 2)} to {number(high, 2)} mg; "
            f"raw values {number(sphere['before'])} mg)."
        )
    if vectors and vectors["holdout_vector_mg"]:
        after, before = (vectors["holdout_vector_mg"][when]["mean"] for when in ("after", "before"))
        held_out = "mg on orientations left out, direction included"
        return f"Error {number(after)} {held_out} (raw values {number(before)} mg)."
    if holdout is not None:
        after, before = holdout["after_mg"]["mean"], holdout["before_mg"]["mean"]
        held_out = "mg on postures that took no part in the fit"
        return f"Error {number(after)} {held_out} (raw values {number(before)} mg)."
    return "Its error is not known."


def model_name(model: str) -> str:
    """What a model corrects."""
    base = MODELS.get(model.removesuffix("T"), model)
    return f"{base}, with slopes by temperature" if model.endswith("T") else base


def methods(report: Report) -> str:
    """A paragraph for the methods section of a paper."""
    calibration, fit = report["calibration"], report["fit"]
    windows, version = fit["windows"].get("used"), report["accelcal_version"]
    used = f"{windows} " if isinstance(windows, int) else ""
    parts = [
        f"Raw acceleration was calibrated with accelcal {version} from {used}windows of "
        f"{advice.setting(report, 'segment_seconds', 5.0):g} s without movement, "
        f"averaged to {counted(report['coverage']['cells'], 'orientation')}."
    ]
    if calibration is None:
        parts.append("The recording could not be calibrated and was left out.")
        return " ".join([*parts, f"Reference: {CITATION.format(version=version)}"])
    equation = "a = K (v + o)" if calibration["temperature"] is None else "a = K (v + o + s (T − Tref))"
    parts.append(
        f"The model {equation} corrects {model_name(calibration['model'])} "
        f"(model {calibration['model']}); "
        f"it was fitted by {calibration['optimizer']['name']} {_fitted_to(report, calibration)}."
    )
    parts += [_errors_for_paper(report), f"Reference: {CITATION.format(version=version)}"]
    return " ".join(parts)


def _fitted_to(report: Report, calibration: Report) -> str:
    """What the fit was to meet."""
    known = report.get("known_orientations")
    if known is not None:
        return f"to {counted(known['orientations'], 'known acceleration')} (Bragge et al.)"
    return f"so that gravity measures {calibration['gravity']['local_g']:.5f} g at rest{_prior(report)}"


def _prior(report: Report) -> str:
    prior = report["settings"].get("prior")
    return "" if prior in (None, "none") else f", with a prior on the parameters ({prior})"


def _errors_for_paper(report: Report) -> str:
    sphere, holdout, text = report.get("sphere_mg"), report["holdout"], ""
    if "unchecked" in report.get("known_orientations", {}):
        return "Its error is not known: no data were held out."
    if holdout is not None:
        after, before = holdout["after_mg"]["mean"], holdout["before_mg"]["mean"]
        text = (
            f"The mean of ||a| − 1 g| on data held out ({holdout['method']}) is "
            f"{number(before)} mg before and {number(after)} mg after calibration."
        )
    if sphere is not None:
        low, high = sphere["ci95"]
        text += (
            f" The expected error over all directions is {number(sphere['mean'])} mg "
            f"(95 % interval {number(low)} to {number(high)} mg)."
        )
    return text.strip()

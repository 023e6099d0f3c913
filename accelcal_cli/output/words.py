"""Words for people about a report: numbers, what an outcome means, what to beware of, and what to do.

Sentences for the terminal and for pages. All of them follow from the report; nothing is judged here.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10
from typing import Literal

from accelcal_cli.core.errors import counted, listed
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.output.report_view import CalibrationView, KnownOrientationsView, ReportView

LIMIT_MG = DEFAULT.max_error_mg
"""Limit [mg] of the 95 % interval of a good result, where a report's settings do not say."""

MIN_POSTURES = 9
"""Number of postures from which on a recording does not lack any, unless they leave out a side."""

RIGHT_G = (0.7, 1.4)
"""Bounds of the median of |a| at rest [g] if unit and scale are right."""

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
CITATION = (
    "Farago, Maczak, Gingl (2024): Enhancing Accuracy in Actigraphic Measurements. IEEE Access; "
    "the procedure as implemented in accelcal {version}."
)

PARAMETERS = {
    **{f"k_{axis}{axis}": f"scale of {axis}" for axis in "xyz"},
    **{f"k_{row}{of}": f"misalignment: {of} in {row}" for row in "xyz" for of in "xyz" if row != of},
    **{f"o{axis}": f"offset of {axis} [g]" for axis in "xyz"},
    **{f"s{axis}": f"change of the offset of {axis} [g per °C]" for axis in "xyz"},
}
"""Meaning of each parameter of a calibration."""

MODELS = {
    "0": "no correction",
    "3": "offsets",
    "6": "scales and offsets",
    "9": "scales, misalignments and offsets",
    "12": "the full gain matrix and offsets",
}
"""Corrections that each model makes, slopes by temperature aside."""

NUMBERS_OF_PARAMETERS = {"3": "three", "6": "six", "9": "nine", "12": "twelve"}


@dataclass(frozen=True, slots=True)
class OutcomeWords:
    """Meaning of an outcome.

    Attributes:
        result: words on a result's line; headline: words at the beginning of a page, if they differ.
        to_do: what to do with the recording, a sentence.
        use: what to do with the recordings of a study, in a few words.
        usable: there is a calibrated recording, or one that needs no calibration.
    """

    result: str
    to_do: str
    use: str
    headline: str = ""
    usable: bool = True


OUTCOMES = {
    "calibrated": OutcomeWords("calibrated", "Use the calibrated recording.", "use them"),
    "reduced_model": OutcomeWords(
        "calibrated in part",
        "Use the calibrated recording; the reason says which corrections were left out.",
        "use them; a simpler model was fitted",
    ),
    "already_good": OutcomeWords(
        "good as it is",
        "Use the recording as it is: its raw values are no worse than calibrated ones would be.",
        "use them as they are: the raw data were good",
        headline="good as it is, no correction needed",
    ),
    "borrowed": OutcomeWords(
        "calibrated with another recording's coefficients",
        "Compare the errors before and after, on its own still windows, before you use it.",
        "use them; the coefficients are those of another recording of the device",
    ),
    "refused": OutcomeWords(
        "refused",
        "Do not use this recording as calibrated; no calibrated data were written.",
        "not calibrated",
        usable=False,
    ),
    "failed": OutcomeWords("failed", "", "could not be read or processed", usable=False),
}
"""Outcomes of a study's recordings, the best first; reports have all but `failed`."""


def outcome_words(outcome: str) -> OutcomeWords:
    """Return what an outcome means; of one that is not known only its name."""
    return OUTCOMES.get(outcome) or OutcomeWords(outcome, "", "")


def number(value: float | None, digits: int = 3) -> str:
    """Write a number for a page: significant digits, at least all before the point; a dash for none."""
    if value is None:
        return "–"
    places = 0 if value == 0 else max(0, digits - 1 - floor(log10(abs(value))))
    text = f"{value:.{min(places, 9)}f}"
    text = text.rstrip("0").removesuffix(".") if "." in text else text
    return text.replace("-", "−") if float(text) else text.removeprefix("-")


def millionths(value: float | None) -> str:
    """Write a coefficient or its standard error for a page, to a millionth; a dash for none."""
    return "–" if value is None else f"{value:.6f}".replace("-", "−")


def figure(value: float | None, digits: int = 3) -> str:
    """Write a number for the terminal: significant digits, zeros at the end included; `-` for none."""
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}".rstrip(".")


def formatted(value: float | None, form: str) -> str:
    """Write a number for the terminal by a format; `-` for none."""
    return "-" if value is None else format(value, form)


def mg(value: float | None) -> str:
    """Write an error [mg] in a sentence: three digits, without zeros at the end; `-` for none."""
    return "-" if value is None else f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def mg_of_two_digits(value: float) -> str:
    """Write an error [mg] where there is little room."""
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def with_error(value: float, error: float) -> str:
    """Write a value and its standard error, this to two significant digits."""
    digits = 2 if error <= 0 else min(6, max(0, 1 - floor(log10(error))))
    return f"{value:+.{digits}f} +- {error:.{digits}f}"


def parameters_of(model: str) -> str:
    """Name a model by its parameters: `nine parameters and temperature`."""
    number_of = NUMBERS_OF_PARAMETERS.get(model.removesuffix("T"))
    if number_of is None:
        return f"model {model}"
    return f"{number_of} parameters{' and temperature' if model.endswith('T') else ''}"


def corrections_of(model: str) -> str:
    """Name a model by what it corrects: `scales and offsets, with slopes by temperature`."""
    base = MODELS.get(model.removesuffix("T"), model)
    return f"{base}, with slopes by temperature" if model.endswith("T") else base


def cautions(report: ReportView) -> tuple[str, ...]:
    """Return what speaks against trusting a result without a look."""
    everywhere = report.sphere_mg is not None
    sentences = [*filter(None, [unchecked_poses(report)]), *doubts(*_interval(report), everywhere=everywhere)]
    changed = report.change is not None and report.change.kind != "none"
    if changed and (report.calibration is None or report.calibration.course is None):
        sentences.append(
            "The sensor changed while it recorded, and the calibration does not follow it: "
            "see the error by the hour."
        )
    elif changed:
        sentences.append(
            "The sensor changed while it recorded; the calibration follows it. Have the device checked."
        )
    if any(one.found for one in report.misfits or ()):
        sentences.append(
            "The sensor does something that coefficients cannot put right (docs/misfit.md): "
            "have the device checked."
        )
    if report.coverage.saturated:
        sentences.append("An axis stops measuring short of its range: have the device checked.")
    return tuple(sentences)


def _interval(report: ReportView) -> tuple[float | None, float | None, float]:
    """Return the upper end of the error's 95 % interval, the error before, and the limit [mg]."""
    sphere, holdout = report.sphere_mg, report.holdout
    limit = report.setting("max_error_mg", LIMIT_MG)
    if report.outcome == Outcome.ALREADY_GOOD:
        return (None if sphere is None else sphere.ci95[1]), None, limit
    if sphere is not None:
        return sphere.ci95[1], sphere.before, limit
    if holdout is not None:
        return holdout.ci95_mg[1], holdout.before_mg.mean, limit
    return None, None, limit


def doubts(
    high: float | None, before: float | None, limit: float = LIMIT_MG, *, everywhere: bool = True
) -> list[str]:
    """Return what a 95 % interval says against a result [mg].

    Args:
        high: upper end of the interval; before: error of the raw values to compare with, if there is one.
        everywhere: the interval is that of the whole sphere, not only of the recording's own postures.
    """
    if high is None:
        return []
    sentences = []
    if high >= limit:
        where = "in postures that are not in the recording" if everywhere else "on average"
        sentences.append(
            f"The error may reach {mg(high)} mg {where}: do not rely on it where a few mg matter."
        )
    if before is not None and high >= before:
        sentences.append(
            f"This may be no better than the raw values: their {mg(before)} mg lie within the interval."
        )
    return sentences


def unchecked_poses(report: ReportView) -> str | None:
    """Say that nothing speaks for a calibration from known orientations; None where something does."""
    known = report.known_orientations
    if known is None or known.unchecked is None or report.calibration is None:
        return None
    return UNCHECKED_ROLLED if known.rolls else UNCHECKED


def unchecked(report: ReportView) -> str | None:
    """Name the sides on which a calibrated device never rested; None if it rested on all."""
    faces = _faces(report) if report.coverage.cells else []
    if report.calibration is None or not faces:
        return None
    return f"It never rested with {listed(faces)} pointing up: what it measures there was not checked."


def ways_on(report: ReportView) -> tuple[str, ...]:
    """Return what would make a refused recording one that can be used, as far as the report tells."""
    health, cells = report.file_health, report.coverage.cells
    if (health.lost_percent or 0) > report.setting("max_damage_percent", 100.0):
        return ()  # the message says all
    if health.rest and not RIGHT_G[0] < health.rest.median_g < RIGHT_G[1]:
        return (UNIT,)
    if report.settings.get("input", {}).get("format") == "points":
        return _postures(report) if cells else ()
    if not cells:
        again = "Record again: the device has to lie still for some seconds, in different postures."
        return again, BY_OTHERS, OF_ANOTHER
    return (*_postures(report), OF_ANOTHER)


def _postures(report: ReportView) -> tuple[str, ...]:
    """Say which postures are missing."""
    sentences, faces = [], _faces(report)
    orientations = report.coverage.distinct_orientations
    if orientations is not None and (faces or orientations < report.setting("min_postures", MIN_POSTURES)):
        sentences.append(
            f"Stillness was found in {counted(orientations, 'posture')}. "
            "More turns of the wrist, and a longer recording, help."
        )
    if faces:
        side = "that side" if len(faces) == 1 else "each of these sides"
        sentences.append(
            f"The device never rested with {listed(faces)} pointing up. "
            f"Take it off and leave it for a minute on {side}."
        )
    return tuple(sentences)


def _faces(report: ReportView) -> list[str]:
    """Return directions of axes, such as `-z`, that no point comes near."""
    coverage, reach = report.coverage, report.setting("coverage_g", 0.3)
    return [
        f"{sign}{axis}"
        for axis, low, high in zip("xyz", coverage.axis_min_g, coverage.axis_max_g, strict=True)
        for sign, there in (("-", low <= -reach), ("+", high >= reach))
        if not there
    ]


@dataclass(frozen=True, slots=True)
class PageVerdict:
    """Verdict at the beginning of a recording's page.

    Attributes:
        level: class of its colour.
        headline: one sentence; reason: the report's message; to_do: what to do, a sentence each.
    """

    level: Literal["good", "care", "bad"]
    headline: str
    reason: str
    to_do: tuple[str, ...]


def page_verdict(report: ReportView) -> PageVerdict:
    """Return the verdict on a recording."""
    words, doubtful = outcome_words(report.outcome), cautions(report)
    if report.outcome == Outcome.REFUSED:
        headline = "Refused: this recording could not be calibrated."
        return PageVerdict("bad", headline, report.message, (words.to_do, *ways_on(report)))
    good = not doubtful and report.outcome != Outcome.BORROWED
    opening = f"{'Good' if good else 'Use with care'}: {words.headline or words.result}"
    return PageVerdict(
        "good" if good else "care",
        f"{opening}. {_error(report)}",
        report.message,
        (words.to_do, *doubtful, *filter(None, (unchecked(report),))),
    )


def _error(report: ReportView) -> str:
    """Return the number to quote, in a sentence."""
    sphere, holdout, known = report.sphere_mg, report.holdout, report.known_orientations
    if sphere is not None:
        low, high = sphere.ci95
        return (
            f"Error over the whole sphere {number(sphere.mean, 2)} mg "
            f"(95 % interval {number(low, 2)} to {number(high, 2)} mg; "
            f"raw values {number(sphere.before)} mg)."
        )
    if known is not None and known.holdout_vector_mg is not None:
        after, before = known.holdout_vector_mg.after.mean, known.holdout_vector_mg.before.mean
        held_out = "mg on orientations left out, direction included"
        return f"Error {number(after)} {held_out} (raw values {number(before)} mg)."
    if holdout is not None:
        held_out = "mg on postures that took no part in the fit"
        before = holdout.before_mg.mean
        return f"Error {number(holdout.after_mg.mean)} {held_out} (raw values {number(before)} mg)."
    return "Its error is not known."


def methods_paragraph(report: ReportView) -> str:
    """Return a paragraph for the methods section of a paper."""
    calibration, windows, version = report.calibration, report.fit.windows, report.accelcal_version
    reference = f"Reference: {CITATION.format(version=version)}"
    used = windows.get("used")
    parts = [
        f"Raw acceleration was calibrated with accelcal {version} from "
        f"{f'{used} ' if isinstance(used, int) else ''}windows of "
        f"{report.setting('segment_seconds', 5.0):g} s without movement, "
        f"averaged to {counted(report.coverage.cells, 'orientation')}."
    ]
    if calibration is None:
        return " ".join([*parts, "The recording could not be calibrated and was left out.", reference])
    equation = "a = K (v + o)" if calibration.temperature is None else "a = K (v + o + s (T − Tref))"
    parts.append(
        f"The model {equation} corrects {corrections_of(calibration.model)} (model {calibration.model}); "
        f"it was fitted by {calibration.optimizer['name']} {_fitted_to(report, calibration)}."
    )
    return " ".join([*parts, _errors_for_paper(report, report.known_orientations), reference])


def _fitted_to(report: ReportView, calibration: CalibrationView) -> str:
    """Say what the fit was to meet."""
    known, prior = report.known_orientations, report.settings.get("prior")
    if known is not None:
        return f"to {counted(known.orientations, 'known acceleration')} (Bragge et al.)"
    by_prior = "" if prior in (None, "none") else f", with a prior on the parameters ({prior})"
    return f"so that gravity measures {calibration.gravity['local_g']:.5f} g at rest{by_prior}"


def _errors_for_paper(report: ReportView, known: KnownOrientationsView | None) -> str:
    sphere, holdout, text = report.sphere_mg, report.holdout, ""
    if known is not None and known.unchecked is not None:
        return "Its error is not known: no data were held out."
    if holdout is not None:
        text = (
            f"The mean of ||a| − 1 g| on data held out ({holdout.method}) is "
            f"{number(holdout.before_mg.mean)} mg before and "
            f"{number(holdout.after_mg.mean)} mg after calibration."
        )
    if sphere is not None:
        low, high = sphere.ci95
        text += (
            f" The expected error over all directions is {number(sphere.mean)} mg "
            f"(95 % interval {number(low)} to {number(high)} mg)."
        )
    return text.strip()

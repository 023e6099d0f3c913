"""A paragraph for the methods section of a paper, and the references that go with it."""

from __future__ import annotations

from accelcal_cli.core.errors import counted
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.numbers import number
from accelcal_cli.output.sections import CalibrationSection, HoldoutSection, KnownOrientations, ReportView
from accelcal_cli.output.sentences import corrections_of, smaller_by

SOFTWARE = """@software{{accelcal,
  title = {{accelcal: autocalibration of raw accelerometer recordings}},
  author = {{{{accelcal developers}}}},
  year = {{2026}},
  version = {{{version}}}
}}
"""

FARAGO, VAN_HEES, BRAGGE = "Faragó et al., 2024", "van Hees et al., 2014", "Bragge et al."
"""How the paragraph cites the works that it may cite."""

WORKS = {
    FARAGO: (
        "Faragó, Maczák and Gingl (2024), IEEE Access 12",
        """@article{farago2024,
  title = {Enhancing Accuracy in Actigraphic Measurements: A Lightweight Calibration Method for Triaxial
    Accelerometers},
  author = {Farag{\\'o}, D{\\'e}nes and Macz{\\'a}k, B{\\'a}lint and Gingl, Zolt{\\'a}n},
  journal = {IEEE Access},
  volume = {12},
  year = {2024}
}
""",
    ),
    VAN_HEES: (
        "van Hees et al. (2014), J Appl Physiol 117, 738-744, doi:10.1152/japplphysiol.00421.2014",
        """@article{vanhees2014,
  title = {Autocalibration of accelerometer data for free-living physical activity assessment using local
    gravity and temperature: an evaluation on four continents},
  author = {van Hees, Vincent T. and Fang, Zhou and Langford, Joss and others},
  journal = {Journal of Applied Physiology},
  volume = {117},
  number = {7},
  pages = {738--744},
  year = {2014},
  doi = {10.1152/japplphysiol.00421.2014}
}
""",
    ),
    BRAGGE: (
        "Bragge et al., Calibration of triaxial accelerometer by determining sensitivity matrix and offsets "
        "simultaneously",
        """@misc{bragge,
  title = {Calibration of triaxial accelerometer by determining sensitivity matrix and offsets
    simultaneously},
  author = {Bragge, Timo and Hakkarainen, Marko and Tarvainen, Mika P. and Liikavainio, Tuomas and
    Arokoski, Jari and Karjalainen, Pasi A.}
}
""",
    ),
}
"""For each citation the work in short, and its BibTeX entry."""


def references(report: ReportView) -> str:
    """Return the works that the paragraph cites, in short."""
    return "; ".join(short for short, _ in _cited(report))


def bibtex(report: ReportView) -> str:
    """Return accelcal and the works that the paragraph cites as BibTeX entries."""
    entries = (entry for _, entry in _cited(report))
    return "".join((SOFTWARE.format(version=report.accelcal_version), *entries))


def _cited(report: ReportView) -> list[tuple[str, str]]:
    paragraph = methods_paragraph(report)
    return [work for citation, work in WORKS.items() if citation in paragraph]


def methods_paragraph(report: ReportView) -> str:
    """Return a paragraph for the methods section of a paper."""
    calibration, errors = report.calibration, _errors(report, report.known_orientations)
    tool = f"accelcal {report.accelcal_version}"
    if calibration is not None and report.outcome is Outcome.BORROWED and report.pool is None:
        opening = f"Raw acceleration was calibrated with {tool}, by the coefficients of another recording."
        return " ".join([opening, _model(report, calibration), *errors])
    opening = f"Raw acceleration was autocalibrated with {tool}, {_windows(report)}."
    if calibration is None:
        return f"{opening} The recording could not be calibrated and was left out."
    if calibration.model == "0":
        unchanged = "No model improved on the raw values, so they were used as they are."
        return " ".join([opening, unchanged, *errors])
    return " ".join([opening, _model(report, calibration), _fit(report, calibration), *errors])


def _windows(report: ReportView) -> str:
    """Say what the fit was made of, and whose idea that is."""
    used, seconds = report.fit.windows.used, report.setting("segment_seconds", 5.0)
    still = counted(used, "still window")
    if report.known_orientations is not None:
        return (
            f"from {still} of {seconds:g} s in {counted(report.known_orientations.orientations, 'position')}"
        )
    return (
        f"from the gravity measured in {still} ({_rule(report, seconds)}; after {VAN_HEES}), "
        f"averaged by orientation to {counted(report.coverage.cells, 'point')}"
    )


def _rule(report: ReportView, seconds: float) -> str:
    """Say which periods count as still, with the limits of the default rule."""
    periods = f"periods of {seconds:g} s"
    if report.settings.get("stillness") != "both":
        return f"{periods} without movement"
    spread = report.setting("stillness_threshold_g", 0.12)
    deviation = report.setting("stillness_deviation_g", 0.013)
    return (
        f"{periods} in which each axis varies by less than {spread:g} g, "
        f"with a standard deviation below {1000 * deviation:g} mg"
    )


def _model(report: ReportView, calibration: CalibrationSection) -> str:
    """Give the equation with all its symbols, what it corrects, and whose it is."""
    equation, symbols = "a = K (v + o)", "K a 3 × 3 matrix, and o the offsets"
    source = FARAGO if report.known_orientations is None else BRAGGE
    if calibration.temperature is not None:
        equation = "a = K (v + o + s (T − Tref))"
        symbols = "K a 3 × 3 matrix, o the offsets at temperature Tref, and s their slopes with temperature T"
        source += f"; the change of the offsets with temperature as in {VAN_HEES}"
    if calibration.bend is not None:
        equation = equation.replace("(v ", "(v + q v² ")
        symbols += ", and q the bend of each axis (after Ang, Khosla and Riviere, 2007)"
    return (
        f"The model {equation} corrects {corrections_of(calibration.model)} ({source}), where v is the raw "
        f"acceleration, a the calibrated one, {symbols}."
    )


def _fit(report: ReportView, calibration: CalibrationSection) -> str:
    """Say what the parameters were fitted to, with what prior and by which optimizer."""
    goal = f"gravity measures {calibration.gravity.local_g:.5f} g in every orientation"
    if report.known_orientations is not None:
        goal = f"the positions measure their known accelerations ({BRAGGE})"
    prior, text = report.settings.get("prior"), f"Its parameters were fitted so that {goal}"
    if prior == "population":
        text += (
            f", with a weakly informative prior (Student's t with {POPULATION.freedom:g} degrees of freedom; "
            f"scale parameter of the distribution {_widths(calibration)})"
        )
    elif prior not in (None, "none"):
        text += ", with a prior learnt from other recordings of the study"
    return f"{text}, by accelcal's optimizer {calibration.optimizer.name}."


def _widths(calibration: CalibrationSection) -> str:
    """Give the prior's width for each kind of parameter."""
    scale, misalignment, offset, slope = POPULATION.width[::3]
    widths = [
        f"{scale:g} for scale",
        f"{misalignment:g} for misalignment",
        f"{1000 * offset:g} mg for offsets",
    ]
    if calibration.temperature is not None:
        widths.append(f"{1000 * slope:g} mg/°C for slopes")
    return ", ".join(widths)


def _errors(report: ReportView, known: KnownOrientations | None) -> list[str]:
    everywhere, holdout = report.calibration_error_mg, report.holdout
    if known is not None and known.unchecked is not None:
        return ["Its error is not known: no data were held out."]
    sentences = []
    if everywhere is not None:
        low, high = everywhere.ci95
        sentences.append(
            "The expected calibration error, the mean of ||a| − 1 g| over all directions of gravity, is "
            f"{number(everywhere.mean)} mg (95 % credible interval {number(low)} to {number(high)} mg)."
        )
    if holdout is not None:
        sentences.append(held_out_sentence(holdout))
    return sentences


def held_out_sentence(holdout: HoldoutSection) -> str:
    """Return the errors on data that were held out of the fit, in a sentence."""
    method = holdout.method.replace("posture", "orientation")
    return (
        f"On data held out of the fit ({method}), the mean of ||a| − 1 g| is "
        f"{number(holdout.before_mg.mean)} mg before and {number(holdout.after_mg.mean)} mg after "
        f"calibration{smaller_by(holdout)}."
    )

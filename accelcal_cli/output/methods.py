"""A paragraph for the methods section of a paper, and the references that go with it."""

from __future__ import annotations

from accelcal_cli.core.errors import counted
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.output.numbers import number, times_smaller
from accelcal_cli.output.report_view import CalibrationView, HoldoutView, KnownOrientationsView, ReportView
from accelcal_cli.output.words import corrections_of

FARAGO = "Faragó, Maczák and Gingl (2024), IEEE Access 12"
VAN_HEES = "van Hees et al. (2014), J Appl Physiol 117, 738-744, doi:10.1152/japplphysiol.00421.2014"
BRAGGE = "Bragge et al., Calibration of triaxial accelerometer by determining sensitivity matrix and offsets"

BIBTEX = """@software{{accelcal,
  title = {{accelcal: autocalibration of raw accelerometer recordings}},
  author = {{{{accelcal developers}}}},
  year = {{2026}},
  version = {{{version}}}
}}
@article{{farago2024,
  title = {{Enhancing Accuracy in Actigraphic Measurements: A Lightweight Calibration Method for Triaxial
    Accelerometers}},
  author = {{Farag{{\\'o}}, D{{\\'e}}nes and Macz{{\\'a}}k, B{{\\'a}}lint and Gingl, Zolt{{\\'a}}n}},
  journal = {{IEEE Access}},
  volume = {{12}},
  year = {{2024}}
}}
@article{{vanhees2014,
  title = {{Autocalibration of accelerometer data for free-living physical activity assessment using local
    gravity and temperature: an evaluation on four continents}},
  author = {{van Hees, Vincent T. and Fang, Zhou and Langford, Joss and others}},
  journal = {{Journal of Applied Physiology}},
  volume = {{117}},
  number = {{7}},
  pages = {{738--744}},
  year = {{2014}},
  doi = {{10.1152/japplphysiol.00421.2014}}
}}
"""


def references(report: ReportView) -> str:
    """Return the works that the paragraph cites, in short."""
    known = () if report.known_orientations is None else (BRAGGE,)
    return "; ".join((FARAGO, VAN_HEES, *known))


def bibtex(report: ReportView) -> str:
    """Return the references as BibTeX entries."""
    return BIBTEX.format(version=report.accelcal_version)


def methods_paragraph(report: ReportView) -> str:
    """Return a paragraph for the methods section of a paper."""
    calibration, version = report.calibration, report.accelcal_version
    parts = [f"Raw acceleration was autocalibrated with accelcal {version}, {_windows(report)}."]
    if calibration is None:
        return " ".join([*parts, "The recording could not be calibrated and was left out."])
    parts += [_model(calibration), _fit(report, calibration)]
    return " ".join([*parts, *_errors(report, report.known_orientations)])


def _windows(report: ReportView) -> str:
    """Say what the fit was made of, and whose idea that is."""
    used, seconds = report.fit.windows.get("used"), report.setting("segment_seconds", 5.0)
    still = "still windows" if not isinstance(used, int) else counted(used, "still window")
    points = counted(report.coverage.cells, "point")
    if report.known_orientations is not None:
        return (
            f"from {still} of {seconds:g} s in {counted(report.known_orientations.orientations, 'position')}"
        )
    return (
        f"from the gravity measured in {still} (periods of {seconds:g} s without movement; van Hees et al., "
        f"2014), averaged by orientation to {points}"
    )


def _model(calibration: CalibrationView) -> str:
    equation = "a = K (v + o)" if calibration.temperature is None else "a = K (v + o + s (T − Tref))"
    source = " (Faragó et al., 2024)"
    if calibration.temperature is not None:
        source = " (Faragó et al., 2024, with offsets that change with temperature)"
    return f"The model {equation} corrects {corrections_of(calibration.model)}{source}."


def _fit(report: ReportView, calibration: CalibrationView) -> str:
    """Say what the parameters were fitted to, with what prior and by which optimizer."""
    known, prior = report.known_orientations, report.settings.get("prior")
    goal = f"gravity measures {calibration.gravity['local_g']:.5f} g in every orientation"
    if known is not None:
        goal = "the positions measure their known accelerations (Bragge et al.)"
    text = f"Its parameters were fitted so that {goal}"
    if prior == "population":
        text += (
            f", with a weakly informative prior (Student's t with {POPULATION.freedom:g} degrees of freedom; "
            f"scale parameters {POPULATION.width[0]:g} for scale, {POPULATION.width[3]:g} for misalignment, "
            f"{1000 * POPULATION.width[6]:g} mg for offsets)"
        )
    elif prior not in (None, "none"):
        text += ", with a prior learnt from other recordings of the study"
    return f"{text}, by the optimizer {calibration.optimizer['name']}."


def _errors(report: ReportView, known: KnownOrientationsView | None) -> list[str]:
    everywhere, holdout = report.error_everywhere, report.holdout
    if known is not None and known.unchecked is not None:
        return ["Its error is not known: no data were held out."]
    sentences = []
    if everywhere is not None:
        low, high = everywhere.ci95
        sentences.append(
            "The expected calibration error over all orientations, the mean of ||a| − 1 g| that the fit "
            f"leaves uncertain, is {number(everywhere.mean)} mg "
            f"(95 % interval {number(low)} to {number(high)} mg)."
        )
    if holdout is not None:
        sentences.append(held_out_sentence(holdout))
    return sentences


def held_out_sentence(holdout: HoldoutView) -> str:
    """Return the errors on data that were held out of the fit, in a sentence."""
    factor = holdout.improvement_factor
    smaller = "" if factor is None else times_smaller(factor.value, factor.ci95)
    method = holdout.method.replace("posture", "orientation")
    return (
        f"On data held out of the fit ({method}), the mean of ||a| − 1 g| is "
        f"{number(holdout.before_mg.mean)} mg before and {number(holdout.after_mg.mean)} mg after "
        f"calibration{smaller}."
    )

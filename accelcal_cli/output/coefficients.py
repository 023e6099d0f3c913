"""Coefficients as JSON and read back: exact integers, and the same as numbers for people.

What a report is made of is in `report.py`, how it is read from its file in `report_reading.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.arithmetic import FRACTION_BITS, LIMIT, ONE, three, to_float
from accelcal_cli.core.calibration import (
    IDENTITY,
    PARAMETER_NAMES,
    UPPER_NAMES,
    Calibration,
    Correction,
    TemperatureScale,
)
from accelcal_cli.core.declared import as_json, from_json
from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS
from accelcal_cli.core.prior import LearntPrior, Prior, Source
from accelcal_cli.core.recording import Device
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import LEARNT_PRIORS
from accelcal_cli.output import sections
from accelcal_cli.output.report_reading import Document, check_sections, damaged, read_document
from accelcal_cli.output.sections import (
    EQUATION,
    AppliedCoefficients,
    BendSection,
    Course,
    FixedPoint,
    GravitySection,
    IntegerKnot,
    Knot,
    PoolMember,
    PriorModel,
    PriorNoise,
    PriorSection,
    Slopes,
    matrix,
    vector,
)

STRETCH = (0.5, 2.0)
"""Bounds of the gains of a sensor, far beyond those that measure about 1 g at rest (0.5 to 1.5 g)."""
LARGEST_OFFSET_G = 1.0
LARGEST_SLOPE_G_PER_C = 0.1
LARGEST_BEND = 0.2
ABSOLUTE_ZERO_MC = -273_150
LAST_SAMPLE = 1 << 53
LEAST, LARGEST = 1e-7, 1e3
"""Bounds of a prior's widths, noise and degrees of freedom."""

FULL_GAIN = "12"
"""Model with nine entries of K and the offsets, which only known orientations determine."""

USED = ("calibration", "recording", "coefficients", "outcome", "message")
"""Sections that are needed to apply a report's coefficients to any recording."""

COPIED = (
    "without_misalignment", "calibration_error_mg", "probability", "uncertainty", "rest_scatter_mg", "change",
    "misfits", "holdout", "fit", "coverage", "models_tried",
)  # fmt: skip
"""Sections that hold for the report's own recording, whoever applies its coefficients."""


def coefficients_json(calibration: Calibration) -> dict[str, Any]:
    """Return everything that is needed to apply a calibration."""
    scale, course, gravity = calibration.temperature, calibration.correction, calibration.gravity
    reference_mc, span_c, slopes = None, None, None
    if scale is not None:
        reference_mc, span_c = scale.reference_mc, scale.span_c
        slopes = Slopes(vector(calibration.slope_g_per_c()), calibration.reference_c())
    section = sections.Coefficients(
        model=calibration.model,
        gain=matrix(calibration.gain()),
        offset_g=vector(calibration.offset_g()),
        parameters={name: to_float(value) for name, value in _integers(calibration, 9).items()},
        bend=BendSection(vector(calibration.bend_per_g())) if any(calibration.bend) else None,
        temperature=slopes,
        course=None if course is None else _course(course),
        equation=EQUATION,
        fixed_point=FixedPoint(
            FRACTION_BITS, _integers(calibration, 12), reference_mc, span_c, calibration.bend
        ),
        gravity=GravitySection(float(gravity.local_g()), gravity.latitude, gravity.altitude_m),
    )
    return as_json(section)


def _course(correction: Correction) -> Course:
    """Return the correction of a sensor that changed, knot by knot."""
    knots = zip(correction.samples, correction.stretch, correction.shift, strict=True)
    return Course(
        "lines" if correction.lines else "jumps",
        tuple(
            Knot(
                sample,
                vector(map(to_float, stretch)),
                vector(map(to_float, shift)),
                IntegerKnot(stretch, shift),
            )
            for sample, stretch, shift in knots
        ),
    )


def _integers(calibration: Calibration, number: int) -> dict[str, int]:
    """Return the parameters by name; those above K's diagonal only where there are any."""
    named = dict(zip(PARAMETER_NAMES[:number], calibration.parameters, strict=False))
    return named | dict(zip(UPPER_NAMES, calibration.upper, strict=True)) if any(calibration.upper) else named


@dataclass(frozen=True, slots=True)
class Origin:
    """The recording whose stillness gave coefficients, and the version that found them."""

    path: str
    sha256: str
    device: Device
    accelcal_version: str


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Coefficients of a report, exactly as it has them.

    Attributes:
        calibration: from the fixed-point integers.
        origin: the recording that they come from, through any number of reports of `apply`.
        by_content: the report is known by its content without the provenance, not by its bytes.
    """

    document: Document
    calibration: Calibration
    origin: Origin
    by_content: bool = False

    @property
    def sha256(self) -> str:
        """Hash by which the report is known."""
        return self.document.content_sha256 if self.by_content else self.document.sha256


def read_coefficients(path: Path, *, by_content: bool = False) -> Coefficients:
    """Read the coefficients of a report, exactly.

    Args:
        by_content: see `Coefficients`.

    Raises:
        UnreadableError: see `read_document`; or a key is missing, wrong or contradicts another, or
            the report's recording was refused.
    """
    return coefficients_in(read_document(path), by_content=by_content)


def coefficients_in(document: Document, *, by_content: bool) -> Coefficients:
    """Return the coefficients of a report that was read; raises what `read_coefficients` does."""
    report = document.report
    if "calibration" in report and report["calibration"] is None:
        why = printable(str(report.get("message")))
        raise UnreadableError(f"holds no coefficients: the recording was refused ({why})", path=document.path)
    check_sections(document, USED)
    if report.get("outcome") == Outcome.REFUSED:
        raise damaged(document, "its recording was refused, but it holds coefficients")
    try:
        calibration = calibration_of(report["calibration"])
    except ValueError as error:
        raise damaged(document, str(error)) from error
    wrong = contradiction(report["calibration"], calibration) or implausible(calibration)
    if wrong:
        raise damaged(document, wrong)
    return Coefficients(document, calibration, _origin(document), by_content)


def without_misalignment(coefficients: Coefficients) -> Calibration | None:
    """Return the calibration without misalignment that a report has in addition; None if it has none.

    Raises:
        UnreadableError: that section is damaged.
    """
    document = coefficients.document
    if document.report.get("without_misalignment") is None:
        return None
    check_sections(document, ("without_misalignment",))
    section = document.report["without_misalignment"]["calibration"]
    try:
        calibration = calibration_of(section)
    except ValueError as error:
        raise damaged(document, f"without_misalignment: {error}") from error
    wrong = contradiction(section, calibration) or implausible(calibration)
    if calibration.model not in ("6", "6T"):
        wrong = f"calibration.model is {calibration.model!r}"
    if wrong:
        raise damaged(document, f"without_misalignment: {wrong}")
    return calibration


def _origin(document: Document) -> Origin:
    section, recording = document.report.get("coefficients"), document.recording
    if section is None:
        version = str(document.report["accelcal_version"])
        return Origin(recording.path, recording.sha256, recording.device, version)
    applied = from_json(AppliedCoefficients, section)
    return Origin(applied.recording_path, applied.recording_sha256, applied.device, applied.accelcal_version)


def calibration_of(section: Mapping[str, Any]) -> Calibration:
    """Return the calibration of a report's `calibration` section, from its fixed-point integers.

    Raises:
        ValueError: the integers or the model are missing or impossible; the message says which.
    """
    try:
        fixed_point, gravity_section, model = section["fixed_point"], section["gravity"], section["model"]
        integers = {name: fixed_point["parameters"][name] for name in PARAMETER_NAMES}
        upper = {name: fixed_point["parameters"].get(name, 0) for name in UPPER_NAMES}
        scale = _scale(fixed_point["temperature_reference_mc"], fixed_point["temperature_span_c"])
        gravity = Gravity(gravity_section["latitude"], gravity_section["altitude"])
        gravity.local_g()
        bits, bend = fixed_point["fraction_bits"], fixed_point["bend"]
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"calibration lacks what is needed ({error})") from error
    for name, value in (integers | upper).items():
        if type(value) is not int or not -LIMIT < value < LIMIT:
            raise ValueError(f"calibration.fixed_point.parameters.{name} is not a 32-bit integer")
    if bits != FRACTION_BITS:
        raise ValueError(f"calibration.fixed_point.fraction_bits is {bits!r}, not {FRACTION_BITS}")
    most = round(LARGEST_BEND * ONE)
    if (
        not isinstance(bend, list)
        or len(bend) != 3
        or any(type(one) is not int or abs(one) > most for one in bend)
    ):
        raise ValueError("calibration.fixed_point.bend is not of a sensor: three integers")
    xy, xz, yz = upper.values()
    correction = _read_correction(section.get("course"))
    calibration = Calibration(
        model, tuple(integers.values()), scale, gravity, (xy, xz, yz), correction, three(bend)
    )
    _check_model(calibration)
    return calibration


def _read_correction(section: Any) -> Correction | None:
    """Return the correction of a sensor that changed; raises ValueError for an impossible one."""
    if section is None:
        return None
    try:
        knots, lines = section["knots"], {"lines": True, "jumps": False}[section["between"]]
        samples = tuple(knot["sample"] for knot in knots)
        stretch, shift = (
            tuple(_knot(knot["fixed_point"][name], name) for knot in knots) for name in ("stretch", "shift")
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"calibration.course lacks what is needed ({error})") from error
    ascend = all(type(sample) is int for sample in samples) and list(samples) == sorted(set(samples))
    if not ascend or samples[:1] != (0,) or samples[-1] >= LAST_SAMPLE:
        raise ValueError("calibration.course does not begin at sample 0, or its knots do not ascend")
    return Correction(samples, stretch, shift, lines)


def _knot(values: Any, name: str) -> tuple[int, int, int]:
    low, high = (STRETCH[0] * ONE, STRETCH[1] * ONE) if name == "stretch" else (-ONE, ONE)
    if not isinstance(values, list) or any(type(value) is not int for value in values):
        raise ValueError(f"calibration.course has a {name} that is not a list of integers")
    if len(values) != 3 or not all(low <= value <= high for value in values):
        raise ValueError(f"calibration.course has a {name} that no sensor has")
    x, y, z = values
    return x, y, z


def _scale(reference_mc: Any, span_c: Any) -> TemperatureScale | None:
    if reference_mc is None and span_c is None:
        return None
    if type(reference_mc) is not int or not ABSOLUTE_ZERO_MC <= reference_mc < LIMIT:
        raise ValueError(f"calibration.fixed_point.temperature_reference_mc cannot be {reference_mc!r}")
    if isinstance(span_c, bool) or not isinstance(span_c, int | float) or not 0 < span_c < 1e6:
        raise ValueError(f"calibration.fixed_point.temperature_span_c cannot be {span_c!r}")
    return TemperatureScale(reference_mc, float(span_c))


def _check_model(calibration: Calibration) -> None:
    """Raise ValueError if a parameter that the model does not have is not at its ideal value."""
    if not isinstance(calibration.model, str) or calibration.model not in (*MODELS, FULL_GAIN):
        raise ValueError(f"calibration.model is {calibration.model!r}, which this version does not know")
    full, base = calibration.model == FULL_GAIN, calibration.model.removesuffix("T")
    if calibration.model != base + ("T" if calibration.temperature else ""):
        raise ValueError(f"model {calibration.model} and the temperature scale contradict each other")
    free = range(9) if full else MODELS[calibration.model].free
    fixed = [
        name
        for index, name in enumerate(PARAMETER_NAMES)
        if index not in free and calibration.parameters[index] != IDENTITY[index]
    ]
    fixed += [name for name, value in zip(UPPER_NAMES, calibration.upper, strict=True) if value and not full]
    if fixed:
        raise ValueError(f"model {calibration.model} has no parameter {fixed[0]}, but fixed_point gives one")


def contradiction(section: Mapping[str, Any], calibration: Calibration) -> str | None:
    """Name a number of a `calibration` section that its own integers contradict; None if they agree."""
    wrong = (name for name, value in coefficients_json(calibration).items() if section.get(name) != value)
    return next((f"calibration.{name} is not what calibration.fixed_point says" for name in wrong), None)


def implausible(calibration: Calibration) -> str | None:
    """Say why no sensor can have such a calibration; None if one can."""
    stretch = np.linalg.svd(calibration.gain(), compute_uv=False)
    if not (stretch.min() >= STRETCH[0] and stretch.max() <= STRETCH[1]):
        return f"its gain stretches by {stretch.min():.3g} to {stretch.max():.3g}, which no sensor does"
    if np.abs(calibration.offset_g()).max() > LARGEST_OFFSET_G:
        return f"an offset is beyond {LARGEST_OFFSET_G:g} g, which no sensor has"
    if np.abs(calibration.slope_g_per_c()).max() > LARGEST_SLOPE_G_PER_C:
        return f"a slope is beyond {LARGEST_SLOPE_G_PER_C:g} g per C, which no sensor has"
    return None


def prior_json(learnt: LearntPrior) -> dict[str, Any]:
    """Return the `prior` object of a report."""
    prior = learnt.prior
    model = None if learnt.model is None else printable(learnt.model)
    section = PriorSection(
        kind=learnt.kind,
        centre=dict(zip(PARAMETER_NAMES, prior.centre, strict=True)),
        width=dict(zip(PARAMETER_NAMES, prior.width, strict=True)),
        freedom=prior.freedom,
        noise=PriorNoise(prior.noise_g, prior.noise_spread, prior.noise_freedom),
        reference_c=prior.reference_c,
        model=PriorModel(model, learnt.devices, learnt.recordings, learnt.sha256),
        device=tuple(PoolMember(printable(one.name), one.sha256) for one in learnt.own),
    )
    return as_json(section)


def learnt_prior_of(document: Document, kind: str) -> LearntPrior | None:
    """Return the prior with which a report was made, if its settings name one that is learnt.

    Raises:
        UnreadableError: it is missing, or no study learns such a prior.
    """
    if kind not in LEARNT_PRIORS:
        return None
    if "prior" not in document.report:
        raise damaged(document, f"settings.prior is {kind!r}, but there is no prior")
    check_sections(document, ("prior",))
    stated = from_json(PriorSection, document.report["prior"])
    centre, width = (
        tuple(float(values[key]) for key in PARAMETER_NAMES) for values in (stated.centre, stated.width)
    )
    noise = stated.noise
    reference, freedom = stated.reference_c, float(stated.freedom)
    ideal = [value / ONE for value in IDENTITY]
    close = all(abs(value - one) < LARGEST_OFFSET_G for value, one in zip(centre, ideal, strict=True))
    possible = [*width, freedom, noise.g, noise.spread, noise.freedom]
    if stated.kind != kind or not close or not all(LEAST <= value <= LARGEST for value in possible):
        raise damaged(document, "it has a prior that no study learns")
    if reference is not None and not abs(reference) < LARGEST:
        raise damaged(document, "prior.reference_c cannot be")
    prior = Prior(
        centre, width, freedom, float(noise.g), float(noise.spread), float(noise.freedom), reference
    )
    model = stated.model
    own = tuple(Source(one.path, one.sha256) for one in stated.device)
    return LearntPrior(prior, kind, model.name, model.devices, model.recordings, model.sha256, own)

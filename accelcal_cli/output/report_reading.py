"""Reports read back from their files, and their coefficients: exact, and checked one against another."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core import points
from accelcal_cli.core.course import Course
from accelcal_cli.core.errors import UnreadableError, printable
from accelcal_cli.core.fixed import FRACTION_BITS, LIMIT, ONE
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.prior import LearntPrior, Prior, Source
from accelcal_cli.core.recording import Device
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import LEARNT_PRIORS
from accelcal_cli.output.coefficients import coefficients_json
from accelcal_cli.output.files import parsed
from accelcal_cli.output.report import LARGEST_BYTES, SCHEMA_VERSION, upgraded
from accelcal_cli.output.report_schema import fault, schema_of_version

NAME_ONE = "name a report, STEM.calibration.json"
STRETCH = (0.5, 2.0)
"""Gains of a sensor that measures about 1 g at rest lie well within (raw means of 0.5 to 1.5 g)."""
LARGEST_OFFSET_G = 1.0
LARGEST_SLOPE_G_PER_C = 0.1
ABSOLUTE_ZERO_MC = -273_150
LAST_SAMPLE = 1 << 53
LEAST, LARGEST = 1e-7, 1e3
"""Of a width, a noise and degrees of freedom of a prior."""

FULL_GAIN = "12"
"""Nine entries of K and the offsets, of orientations that were known."""

USED = ("calibration", "recording", "coefficients", "outcome", "message")
"""Sections that applying a report's coefficients to any recording needs."""

COPIED = (
    "without_misalignment", "sphere_mg", "change", "misfits", "holdout", "fit", "coverage", "models_tried",
)  # fmt: skip
"""Sections that hold for the recording itself, whatever it is applied by."""


@dataclass(frozen=True, slots=True)
class Document:
    """A report as it lies in its file: `sha256` of the file, and what it says.

    Attributes:
        report: with the names of this schema version.
        first: what the file holds, if that is of schema version 1; else None.
    """

    path: Path
    sha256: str
    report: dict[str, Any]
    first: dict[str, Any] | None = None

    @property
    def content_sha256(self) -> str:
        """SHA-256 of what it says but for `provenance`, as JSON with sorted keys."""
        held = self.report if self.first is None else self.first
        content = {name: value for name, value in held.items() if name != "provenance"}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_document(path: Path) -> Document:
    """A report of this schema version or the one before; its sections are not looked at.

    Raises:
        UnreadableError: it cannot be read, is not JSON, or no report of ours that this version knows.
    """
    data = document_bytes(path)
    try:
        report = parsed(data.decode())
    except UnicodeDecodeError as error:
        start = error.start
        raise UnreadableError("is not UTF-8 text", path=path, byte_offset=start, hint=NAME_ONE) from error
    except ValueError as error:
        raise UnreadableError(f"is not valid JSON ({error})", path=path, hint=NAME_ONE) from error
    if not isinstance(report, dict) or not {"accelcal_version", "schema_version"} <= report.keys():
        raise UnreadableError("is not a report of accelcal", path=path, hint=NAME_ONE)
    version, writer = report["schema_version"], report["accelcal_version"]
    if version not in (1, SCHEMA_VERSION) or isinstance(version, bool):
        raise UnreadableError(
            f"has schema version {version!r} (of accelcal {writer!r}), not one of 1 to {SCHEMA_VERSION}",
            path=path,
            hint="calibrate its recording again with this version, or use the version that wrote it",
        )
    now = upgraded(report)
    return Document(path, hashlib.sha256(data).hexdigest(), now, None if now is report else report)


def document_bytes(path: Path) -> bytes:
    """What a report, or a file that lies beside it, holds.

    Raises:
        UnreadableError: it cannot be read, or is larger than any of ours.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise UnreadableError(
            f"cannot be read ({error.strerror or error})", path=path, hint="check the path and permissions"
        ) from error
    if len(data) > LARGEST_BYTES:
        raise UnreadableError("is too large for a report", path=path, hint=NAME_ONE)
    return data


def check_sections(document: Document, names: tuple[str, ...]) -> None:
    """Raise UnreadableError if sections of a report are missing or not what they should be."""
    schema = schema_of_version(str(document.report["accelcal_version"]))
    wrong = fault(
        document.report,
        {
            "type": "object",
            "properties": {name: schema["properties"][name] for name in names},
            "required": [name for name in schema["required"] if name in names],
        },
    )
    if wrong:
        raise damaged(document, wrong)


def damaged(document: Document, what: str) -> UnreadableError:
    """The error of a report that was not written so."""
    hint = "calibrate its recording again: accelcal did not write this report as it is now"
    return UnreadableError(f"is a damaged report: {what}", path=document.path, hint=hint)


def learnt_prior_of(document: Document, kind: str) -> LearntPrior | None:
    """The prior with which a report was made, if its settings name one that is learnt.

    Raises:
        UnreadableError: it is missing, or cannot be.
    """
    if kind not in LEARNT_PRIORS:
        return None
    if "prior" not in document.report:
        raise damaged(document, f"settings.prior is {kind!r}, but there is no prior")
    check_sections(document, ("prior",))
    held = document.report["prior"]
    centre, width = (
        tuple(float(held[name][key]) for key in points.PARAMETER_NAMES) for name in ("centre", "width")
    )
    noise = [float(held["noise"][name]) for name in ("g", "spread", "freedom")]
    reference = held["reference_c"]
    ideal = [value / ONE for value in points.IDENTITY]
    close = all(abs(value - one) < LARGEST_OFFSET_G for value, one in zip(centre, ideal, strict=True))
    possible = [*width, float(held["freedom"]), *noise]
    if held["kind"] != kind or not close or not all(LEAST <= value <= LARGEST for value in possible):
        raise damaged(document, "it has a prior that no study learns")
    if reference is not None and not abs(reference) < LARGEST:
        raise damaged(document, "prior.reference_c cannot be")
    noise_g, spread, freedom = noise
    prior = Prior(centre, width, float(held["freedom"]), noise_g, spread, freedom, reference)
    model, own = held["model"], tuple(Source(one["path"], one["sha256"]) for one in held["device"])
    return LearntPrior(
        prior, kind, model["name"], model["devices"], model["recordings"], model["sha256"], own
    )


@dataclass(frozen=True, slots=True)
class Origin:
    """The recording whose stillness coefficients were found from, and who found them."""

    path: str
    sha256: str
    device: Device
    accelcal_version: str


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Coefficients of a report.

    Attributes:
        calibration: made of the fixed-point integers.
        origin: where they come from, by whatever number of reports of `apply`.
        by_content: whether the report's provenance does not matter.
    """

    document: Document
    calibration: points.Calibration
    origin: Origin
    by_content: bool = False

    @property
    def sha256(self) -> str:
        """What the report is known by."""
        return self.document.content_sha256 if self.by_content else self.document.sha256


def read_coefficients(path: Path, *, by_content: bool = False) -> Coefficients:
    """The coefficients of a report, exactly.

    Args:
        by_content: whether the report is known by what it says but for its provenance, or by its bytes.

    Raises:
        UnreadableError: see `read_document`; or a key is missing, wrong or contradicts another, or
            the report's recording was refused.
    """
    document = read_document(path)
    report = document.report
    if "calibration" in report and report["calibration"] is None:
        why = printable(str(report.get("message")))
        raise UnreadableError(f"holds no coefficients: the recording was refused ({why})", path=path)
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
    return Coefficients(document, calibration, _origin(report), by_content)


def without_misalignment(found: Coefficients) -> points.Calibration | None:
    """What a report's points gave without misalignment; None where its report has nothing of the kind.

    Raises:
        UnreadableError: that section cannot be.
    """
    document = found.document
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


def _origin(report: Mapping[str, Any]) -> Origin:
    applied, recording = report.get("coefficients"), report["recording"]
    if applied is None:
        path, digest, version = recording["path"], recording["sha256"], report["accelcal_version"]
        return Origin(path, digest, _device(recording["device"]), str(version))
    device = _device(applied["device"])
    return Origin(applied["recording_path"], applied["recording_sha256"], device, applied["accelcal_version"])


def _device(section: Mapping[str, Any]) -> Device:
    """Who recorded; what a later version says besides is passed over."""
    return Device(**{name: section[name] for name in Device.__dataclass_fields__})


def calibration_of(section: Mapping[str, Any]) -> points.Calibration:
    """The calibration of a report's `calibration` section, from its fixed-point integers.

    Raises:
        ValueError: the integers or the model are missing or impossible; the message says which.
    """
    try:
        fixed_point, gravity_section, model = section["fixed_point"], section["gravity"], section["model"]
        integers = {name: fixed_point["parameters"][name] for name in points.PARAMETER_NAMES}
        upper = {name: fixed_point["parameters"].get(name, 0) for name in points.UPPER_NAMES}
        scale = _scale(fixed_point["temperature_reference_mc"], fixed_point["temperature_span_c"])
        gravity = Gravity(gravity_section["latitude"], gravity_section["altitude"])
        gravity.local_g()
        bits = fixed_point["fraction_bits"]
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"calibration lacks what is needed ({error})") from error
    _check_integers({**integers, **upper})
    if bits != FRACTION_BITS:
        raise ValueError(f"calibration.fixed_point.fraction_bits is {bits!r}, not {FRACTION_BITS}")
    xy, xz, yz = upper.values()
    course = _course(section.get("course"))
    calibration = points.Calibration(model, tuple(integers.values()), scale, gravity, (xy, xz, yz), course)
    _check_model(calibration)
    return calibration


def _course(section: Any) -> Course | None:
    """What follows a sensor that changed; raises ValueError for what cannot be."""
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
    return Course(samples, stretch, shift, lines)


def _knot(values: Any, name: str) -> tuple[int, int, int]:
    low, high = (STRETCH[0] * ONE, STRETCH[1] * ONE) if name == "stretch" else (-ONE, ONE)
    if not isinstance(values, list) or any(type(value) is not int for value in values):
        raise ValueError(f"calibration.course has a {name} that is no list of integers")
    if len(values) != 3 or not all(low <= value <= high for value in values):
        raise ValueError(f"calibration.course has a {name} that no sensor has")
    x, y, z = values
    return x, y, z


def _scale(reference_mc: Any, span_c: Any) -> points.TemperatureScale | None:
    if reference_mc is None and span_c is None:
        return None
    if type(reference_mc) is not int or not ABSOLUTE_ZERO_MC <= reference_mc < LIMIT:
        raise ValueError(f"calibration.fixed_point.temperature_reference_mc cannot be {reference_mc!r}")
    if isinstance(span_c, bool) or not isinstance(span_c, int | float) or not 0 < span_c < 1e6:
        raise ValueError(f"calibration.fixed_point.temperature_span_c cannot be {span_c!r}")
    return points.TemperatureScale(reference_mc, float(span_c))


def _check_integers(named: dict[str, Any]) -> None:
    for name, value in named.items():
        if type(value) is not int or not -LIMIT < value < LIMIT:
            raise ValueError(f"calibration.fixed_point.parameters.{name} is not a 32-bit integer")


def _check_model(calibration: points.Calibration) -> None:
    """A parameter that the model does not have keeps its ideal value."""
    if not isinstance(calibration.model, str) or calibration.model not in (*points.MODELS, FULL_GAIN):
        raise ValueError(f"calibration.model is {calibration.model!r}, which this version does not know")
    full, base = calibration.model == FULL_GAIN, calibration.model.removesuffix("T")
    if calibration.model != base + ("T" if calibration.temperature else ""):
        raise ValueError(f"model {calibration.model} and the temperature scale contradict each other")
    free = range(9) if full else points.MODELS[calibration.model].free
    fixed = [
        name
        for index, name in enumerate(points.PARAMETER_NAMES)
        if index not in free and calibration.parameters[index] != points.IDENTITY[index]
    ]
    fixed += [
        name for name, value in zip(points.UPPER_NAMES, calibration.upper, strict=True) if value and not full
    ]
    if fixed:
        raise ValueError(f"model {calibration.model} has no parameter {fixed[0]}, but fixed_point gives one")


def contradiction(section: Mapping[str, Any], calibration: points.Calibration) -> str | None:
    """Which number of a `calibration` section is not what its own integers say, if any."""
    wrong = (name for name, value in coefficients_json(calibration).items() if section.get(name) != value)
    return next((f"calibration.{name} is not what calibration.fixed_point says" for name in wrong), None)


def implausible(calibration: points.Calibration) -> str | None:
    """Why no sensor can have such a calibration, or None."""
    stretch = np.linalg.svd(calibration.gain(), compute_uv=False)
    if not (stretch.min() >= STRETCH[0] and stretch.max() <= STRETCH[1]):
        return f"its gain stretches by {stretch.min():.3g} to {stretch.max():.3g}, which no sensor does"
    if np.abs(calibration.offset_g()).max() > LARGEST_OFFSET_G:
        return f"an offset is beyond {LARGEST_OFFSET_G:g} g, which no sensor has"
    if np.abs(calibration.slope_g_per_c()).max() > LARGEST_SLOPE_G_PER_C:
        return f"a slope is beyond {LARGEST_SLOPE_G_PER_C:g} g per C, which no sensor has"
    return None

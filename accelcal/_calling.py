"""How the public functions are called: keywords that help completes, and errors that speak of keywords."""

from __future__ import annotations

import inspect
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from tempfile import gettempdir
from typing import Any, ParamSpec, TypeVar, get_type_hints

from accelcal_cli.core.errors import AccelcalError, counted, did_you_mean
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import PoseSettings, Settings, setting_of
from accelcal_cli.core.system import folder_start
from accelcal_cli.pipeline.options import GIVEN_VALUE, field_values, not_given, option_fields

# What to type instead of a name that other packages have and this one does not.

NAME, REPORT = '"recording.cwa"', '"recording.calibration.json"'
CALIBRATE = f"accelcal.calibrate({NAME})"
HINTS = {
    r"read_parquet": 'pandas.read_parquet("recording.calibrated.parquet"): it is an ordinary table',
    r"(read|load|open|scan)_(study|table)": 'pandas.read_parquet("OUT/study.parquet")',
    r"(read|load|open)_(report|calibration|coefficients|json)|load": f"accelcal.Calibration({REPORT})",
    r"(read|open|load|scan)_?\w*|Read\w*": f"accelcal.read({NAME}), which knows all formats",
    r"(to|write|save)_(csv|ggir|biobank|bids|npz|mhealth|omconvert)": f"accelcal.export({REPORT}, to=...)",
    r"(write|save|dump)\w*": f"{CALIBRATE}.write(FOLDER)",
    r"calibrate_gravity|calibrate_accelerometer|g_calibrate|\w*processing": f"{CALIBRATE}.to_pandas()",
    r"transform|predict|apply_\w+": f"accelcal.apply({CALIBRATE}, xyz, temperature)",
    r"(process|run|pipeline|main|cli|process_\w+)": f"{CALIBRATE}, or accelcal.study(FOLDER, OUT) for all",
    r"(fit_transform|auto_?calibrate|autocalibration|get_calib\w*|calibration)": CALIBRATE,
    r"(\w*Calibrat(or|e|ion)\w*)": f"{CALIBRATE}.calibration",
    r"(batch|calibrate_(all|folder|many|files|study)|map)": "accelcal.study(FOLDER, OUT)",
    r"(plot|show|hist)\w*": f"{CALIBRATE}.plot()",
    r"(info|describe|summary|header|head|predict_outcome)": 'accelcal.inspect("recording.cwa")',
    r"(enmo|ENMO|mad|metrics?|activity)": 'accelcal.effect("recording.cwa", epoch=60)',
    r"(?i:ggir\w*|biobank\w*|omconvert|actipy|skdh)": "accelcal.export(RESULTS, to=..., folder=DIR)",
    r"(?i:version)": "accelcal.__version__",
    r"(options|set_option|config)": "help(accelcal.calibrate), which lists them",
    r"(exceptions?|errors?|Error|\w+Error)": "accelcal.AccelcalError",
}
"""For patterns of names of the module: what to type."""

OF_OBJECTS = {
    r"(data|df|frame|dataframe|table|to_df|to_dataframe|to_table|samples|xyz|head|tail|iloc|loc)":
        "result.to_pandas(), .to_polars(), .to_arrow(), or result.batches() piece by piece",
    r"(to_numpy|array|as_array|__array__)": 'result.to_pandas()[["x", "y", "z"]].to_numpy()',
    r"(transform|predict|apply|fit_transform)": "result.calibration(xyz, temperature)",
    r"(gain|scale|scale_|gain_|k|K|coef_?|offset_?|intercept_?|slope|coefficients|(get_)?param(eter)?s)":
        "result.calibration.gain, .offset and .slope",
    r"(fit|fit_\w+)": "accelcal.calibrate(xyz, rate=100), which finds and judges the still windows itself",
    r"(save|to_csv|to_parquet|to_file|export|dump)": "result.write(FOLDER), accelcal.export(result, to=)",
    r"(to_json|json|to_dict|as_dict)": "result.report, which json.dump can write",
    r"(error|error_mg|mean_error|score|rmse)": "result.calibration_error_mg",
    r"(show|display|figure|html)": "result.plot(), or result.to_html()",
    r"(status|success|ok|good|quality_flag|is_good)": "result.usable, result.outcome and result.cautions",
    r"(enmo|ENMO|mad|MAD|metrics?|activity)": 'accelcal.effect("recording.cwa", epoch=60)',
    r"(info|describe|meta|metadata|header)": 'result.report["recording"], or result.summary()',
}  # fmt: skip
"""The same of attributes of results and calibrations."""

KEYWORDS = {
    "rate": ("fs", "hz", "sf", "sfreq", "freq", "frequency", "sample_rate", "sampling_rate", "samplerate"),
    "timezone": ("tz", "zone", "time_zone"), "unit": ("units",), "start": ("start_time", "begin", "t0"),
    "temperature": ("temp", "temps", "temperatures"), "gyroscope": ("gyro",),
    "output": ("out", "output_dir", "outdir", "outputdir", "out_dir", "output_folder", "save"),
    "source": ("accel", "acc", "acceleration", "xyz", "data", "df", "file", "filename", "path", "recording"),
    "jobs": ("n_jobs", "workers", "num_workers", "processes", "cores"),
    "lsb_per_g": ("scale", "sensitivity", "counts_per_g"), "max_error": ("tolerance", "max_error_mg"),
}  # fmt: skip
"""Keywords of functions, and other packages' names for them."""

ELSEWHERE = {
    "output": "a result writes its files: .write(FOLDER)",
    "jobs": "accelcal.study(FOLDER, OUT, jobs=) works on several recordings at a time",
}
"""What to type for a keyword that the function does not have."""


def _found(hints: dict[str, str], name: str) -> str | None:
    return next((said for pattern, said in hints.items() if re.fullmatch(pattern, name)), None)


def no_such_name(name: str, known: list[str]) -> AttributeError:
    """Return the error of a name that the module has not, with what to type."""
    said = None if name.startswith("_") else _found(HINTS, name) or did_you_mean(name, known)
    return AttributeError(_joined(f"module 'accelcal' has no attribute {name!r}", said), name=name)


def no_such_attribute(kind: str, name: str, of: type) -> AttributeError:
    """Return the error of an attribute that a class has not, with what to type."""
    public = [one for one in dir(of) if not one.startswith("_")]
    said = None if name.startswith("_") else _found(OF_OBJECTS, name) or did_you_mean(name, public)
    return AttributeError(_joined(f"a {kind} has no attribute {name!r}", said), name=name)


def _joined(what: str, said: str | None) -> str:
    asked = not said or said.startswith("did you mean")
    return "; ".join(filter(None, [what, said if asked else f"type {said}"]))


def no_such_option(name: str, known: list[str]) -> TypeError:
    """Return the error of a keyword that a function has not, with the one that was meant."""
    ours = next((one for one, others in KEYWORDS.items() if name.lower() in (one, *others)), "")
    said = f"did you mean {ours!r}?" if ours in known else ELSEWHERE.get(ours) or did_you_mean(name, known)
    return TypeError("; ".join(filter(None, [f"there is no option {name!r}", said])))


# How the public functions are called.

P = ParamSpec("P")
R = TypeVar("R")

OPTION = re.compile(r"--([a-z][a-z-]*)(?: ([A-Z]+\b|[\w./-]+))?")

NAMED = re.compile(rf"-R ([a-z_]+){GIVEN_VALUE}")

COMMAND = re.compile(r"\baccelcal [a-z-]+ ")
"""A command to be typed in a terminal; options of its clause stay as they are."""

STUDY = re.compile(r"\baccelcal study (\S+) -d (\S+)$")
"""The command for a folder, which is a function here."""

SHORT = re.compile(r",? with -[do]\b")
"""The way to name an output at a terminal."""

FLAGS = ("parts", "force", "gzip", "measured_only")
"""Flags that no setting declares."""


def public(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a public function: its options become keywords of its signature, and of its errors."""
    signature = inspect.signature(function)
    given = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
    (kind,) = re.findall(r"^Unpack\[(\w+)\]$", function.__annotations__.get("options", "")) or ("",)
    options = get_type_hints(function.__globals__[kind]) if kind else {}
    known = [one.name for one in given] + [*options]
    keyword = inspect.Parameter.KEYWORD_ONLY
    shown = [
        inspect.Parameter(name, keyword, default=None, annotation=hint) for name, hint in options.items()
    ]
    positional = sum(one.kind is not keyword for one in given)

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        for name in kwargs:
            if name not in known:
                raise no_such_option(name, known)
        if len(args) > positional:
            most = (
                f"{function.__name__} takes {counted(positional - ('self' in known), 'value')} without a name"
            )
            named = "rate" if "rate" in options else known[-1]
            raise TypeError(f"{most}; the others have names, such as {named}=")
        with speaking_python():
            return function(*args, **kwargs)

    called.__signature__ = signature.replace(parameters=[*given, *shown])  # type: ignore[attr-defined]
    return called


@contextmanager
def speaking_python() -> Iterator[None]:
    """Let errors name options as keywords, and what was in memory by what it is, not by a temporary file."""
    try:
        yield
    except AccelcalError as error:
        folder = f"{re.escape(gettempdir())}/{folder_start()}[^/]+/(?:[0-9]+/)?"
        message, hint = (text and re.sub(folder, "", _worded(text)) for text in (error.message, error.hint))
        error.message, error.hint = message or "", hint
        error.path = error.path and Path(re.sub(folder, "", Path(error.path).as_posix()))
        raise error from error.__cause__


def _worded(text: str) -> str:
    known = option_fields(ReadOptions, Settings) | option_fields(PoseSettings)

    def keyword(found: re.Match[str]) -> str:
        name, value = found[1].replace("-", "_"), found[2]
        kind, field = known.get(name, (Settings, "profile"))
        if name in FLAGS or get_type_hints(kind)[field] is bool:
            return f"{name}=True" if value is None else f"{name}=True {value}"
        if value is None:
            return name
        if value.isupper() or _is_number(value):
            return f"{name}={value}"
        if name == "to" or value in setting_of(kind, field).choices:
            return f"{name}={value!r}"
        return f"{name} {value}"

    def study(found: re.Match[str]) -> str:
        folder, out = shlex.split(found[1])[0], found[2]
        return f"accelcal.study({folder!r}, {out!r})"

    def named(found: re.Match[str]) -> str:
        name, value = found[1], (found[2] or "").removeprefix("=")
        if value == "true":
            return f"{name}=True"
        plain = not value or value.isupper() or _is_number(value)
        return "=".join(filter(None, [name, value if plain else repr(value.strip("'"))]))

    def worded(clause: str) -> str:
        return OPTION.sub(keyword, NAMED.sub(named, SHORT.sub("", clause)))

    clauses = [STUDY.sub(study, clause) for clause in text.split("; ")]
    return "; ".join(one if COMMAND.search(one) else worded(one) for one in clauses)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"-?\d+(\.\d+)?", text) is not None


def values_of(options: Mapping[str, Any], *kinds: type) -> dict[str, Any]:
    """Return the options by field, None for those that are not given, as a command line would.

    Raises:
        TypeError, UsageError: see `field_values`.
    """
    return not_given(ReadOptions, Settings) | field_values(options, *kinds)

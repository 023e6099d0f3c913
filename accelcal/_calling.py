"""How the public functions are called: keywords that help completes, and errors that speak of keywords."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial, wraps
from itertools import pairwise
from pathlib import Path
from tempfile import gettempdir
from textwrap import fill
from typing import Any, ParamSpec, TypeVar, get_type_hints

import numpy as np

from accelcal_cli.core.errors import AccelcalError, Reason, UsageError, counted, did_you_mean
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import PoseSettings, Settings, setting_of
from accelcal_cli.core.system import folder_start
from accelcal_cli.output import sentences
from accelcal_cli.pipeline.activity import LONGEST_EPOCH_S
from accelcal_cli.pipeline.options import GIVEN_VALUE, field_values, not_given, option_fields

# What to type instead of a name that other packages have and this one does not.

NAME, REPORT = '"recording.cwa"', '"recording.calibration.json"'
CALIBRATE = f"accelcal.calibrate({NAME})"
HINTS = {
    r"read_parquet": 'pandas.read_parquet("recording.calibrated.parquet"): it is an ordinary table',
    r"(read|load|open|scan)_(study|table)": 'pandas.read_parquet("OUT/study.parquet")',
    r"(read|load|open)_(report|json)|load": f"accelcal.Report({REPORT})",
    r"(read|load|open)_(calibration|coefficients)": f"accelcal.Calibration({REPORT})",
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
    r"(enmo|ENMO|mad|metrics?|activity|epochs?)": f"{CALIBRATE}.epochs(5)",
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
    r"(enmo|ENMO|mad|MAD|metrics?|activity|epoch)": "result.epochs(seconds=5)",
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
    "name": ("subject", "participant", "id", "label"),
    "serial": ("serial_number", "device_id", "device_serial"),
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

COMMAND = re.compile(
    r"`?\baccelcal (calibrate|study|apply|fit|inspect|six-pose|export|report|verify|devices)\b"
)
"""A command that is a function here."""

ELSEWHERE_TYPED = re.compile(r"\baccelcal [a-z-]+ ")
"""Any other command, to be typed in a terminal; options of its clause stay as they are."""

WORD = r"('[^']*'|[^\s;,)`']+)"
GIVEN = {
    "output": re.compile(rf" -d {WORD}"),
    "named": re.compile(rf" -R ([a-z_]+)={WORD}"),
    "option": re.compile(rf" --([a-z][a-z-]*)(?: {WORD})?"),
    "value": re.compile(r" ('[^']*'|[A-Z]{2,}\b|[^\s;,)`']*[./][^\s;,)`']*\w|[^\s;,)`']+(?= -))"),
}
"""Forms of what follows the name of a command and belongs to it."""

SHORT = re.compile(r",?( a name)? with -[do]\b")
"""The way to name an output at a terminal."""

FLAGS = ("parts", "force", "gzip", "measured_only", "borrow", "pool")
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

    called.__doc__ = _with_options(inspect.getdoc(function) or "", function.__globals__.get(kind))
    called.__signature__ = signature.replace(parameters=[*given, *shown])  # type: ignore[attr-defined]
    return called


OPTIONS_LINE = re.compile(r"^    options: .*\n(?:     .*\n)*", re.MULTILINE)
"""The entry of all options in a docstring."""


@cache
def _option_texts(module: str) -> dict[str, dict[str, str]]:
    """Return the text of each option, by the class that holds it, from the source of their module."""
    found: dict[str, dict[str, str]] = {}
    for kind in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(kind, ast.ClassDef):
            bases = [found.get(one.id, {}) for one in kind.bases if isinstance(one, ast.Name)]
            own = {}
            for entry, text in pairwise(kind.body):
                if isinstance(entry, ast.AnnAssign) and isinstance(text, ast.Expr):
                    assert isinstance(entry.target, ast.Name) and isinstance(text.value, ast.Constant)
                    own[entry.target.id] = " ".join(str(text.value.value).split())
            found[kind.name] = {name: said for one in [*bases, own] for name, said in one.items()}
    return found


def _with_options(text: str, kind: type | None) -> str:
    """Return a docstring with an entry for each option of a class in place of that of all."""
    if kind is None:
        return text
    filled = partial(
        fill, width=100, initial_indent=4 * " ", subsequent_indent=8 * " ", break_on_hyphens=False
    )
    entries = [
        filled(f"{name}: {said}") for name, said in _option_texts(kind.__module__)[kind.__name__].items()
    ]
    return OPTIONS_LINE.sub(lambda _: "\n".join([*entries, ""]), text, count=1)


@contextmanager
def speaking_python() -> Iterator[None]:
    """Let errors name options as keywords, and what was in memory by what it is, not by a temporary file."""
    try:
        yield
    except AccelcalError as error:
        folder = f"{re.escape(gettempdir())}/{folder_start()}[^/]+/(?:[0-9]+/)?"
        name = re.sub(folder, "", Path(error.path or "").as_posix())
        held = "" if name == Path(error.path or "").as_posix() else shlex.quote(Path(name).name)
        message, hint = (
            text and re.sub(folder, "", worded(text, held)) for text in (error.message, error.hint)
        )
        error.message, error.hint = message or "", hint
        error.path = error.path and Path(name)
        raise error from error.__cause__


def worded(text: str, held: str = "") -> str:
    """Return a text with functions and keywords in place of commands and options.

    Args:
        held: name of a recording in memory, which a command cannot name.
    """
    clauses = []
    for clause in text.split("; "):
        made, rest = "", clause
        while found := COMMAND.search(rest):
            call, after = _call(found[1], rest[found.end() :], held)
            made, rest = f"{made}{_keywords(rest[: found.start()])}{call}", after
        clauses.append(made + (rest if ELSEWHERE_TYPED.search(rest) else _keywords(rest)))
    return "; ".join(clauses)


def _call(command: str, rest: str, held: str) -> tuple[str, str]:
    """Return the call that a command stands for, and what follows it."""
    values: list[str] = []
    more: list[str] = []
    while kind := next((kind for kind, form in GIVEN.items() if form.match(rest)), None):
        found = GIVEN[kind].match(rest)
        assert found is not None
        rest = rest[found.end() :]
        if kind == "named":
            more.append(_named(found[1], found[2]))
        elif kind == "option":
            name = found[1].replace("-", "_")
            flag = _is_flag(name)
            made = _keyword(name, None if flag else found[2])
            more.append(made if "=" in made or not found[2] else _named(name, found[2]))
            rest = f" {found[2]}{rest}" if flag and found[2] else rest
        else:
            value = found[1].strip("'")
            plain = value.isupper() and kind == "value"
            values.append("..." if held and found[1] == held else value if plain else repr(value))
    call = f"accelcal.{command.replace('six-pose', 'from_poses')}"
    return f"{call}({', '.join([*values, *more])})" if values or more else call, rest.removeprefix("`")


def _keywords(text: str) -> str:
    text = NAMED.sub(lambda found: _named(found[1], found[2] or ""), SHORT.sub("", text))
    return OPTION.sub(lambda found: _keyword(found[1], found[2]), text)


def _option(name: str) -> tuple[type, str]:
    """Return the class and the field of an option."""
    known = option_fields(ReadOptions, Settings) | option_fields(PoseSettings)
    return known.get(name, (Settings, "profile"))


def _is_flag(name: str) -> bool:
    kind, field = _option(name)
    return name in FLAGS or get_type_hints(kind)[field] is bool


def _keyword(option: str, value: str | None) -> str:
    name = option.replace("-", "_")
    kind, field = _option(name)
    if _is_flag(name):
        return f"{name}=True" if value is None else f"{name}=True {value}"
    if value is None:
        return name
    if not value.isupper() and (name in ("to", "sensor") or value in setting_of(kind, field).choices):
        return f"{name}={value!r}"
    return f"{name}={value}" if value.isupper() or _is_number(value) else f"{name} {value}"


def _named(name: str, given: str) -> str:
    value = given.removeprefix("=")
    if value == "true":
        return f"{name}=True"
    plain = not value or value.isupper() or _is_number(value)
    return "=".join(filter(None, [name, value if plain else repr(value.strip("'"))]))


def sentence(reason: Reason) -> str:
    """Return the sentence of a reason, a caution or a piece of advice, with options as keywords."""
    return worded(sentences.sentence(reason))


def _is_number(text: str) -> bool:
    return re.fullmatch(r"-?\d+(\.\d+)?", text) is not None


def check_epoch(name: str, seconds: Any) -> None:
    """Raise TypeError or UsageError for what cannot be the length of an epoch."""
    if isinstance(seconds, bool) or not isinstance(seconds, int | np.integer):
        raise TypeError(f"{name} cannot be {seconds!r}")
    if not 1 <= seconds <= LONGEST_EPOCH_S:
        raise UsageError(f"{name} cannot be {seconds}", hint=f"possible: 1 to {LONGEST_EPOCH_S}")


def values_of(options: Mapping[str, Any], *kinds: type) -> dict[str, Any]:
    """Return the options by field, None for those that are not given, as a command line would.

    Raises:
        TypeError, UsageError: see `field_values`.
    """
    return not_given(ReadOptions, Settings) | field_values(options, *kinds)

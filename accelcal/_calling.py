"""How the public functions are called: keywords that help completes, and errors that speak of keywords."""

from __future__ import annotations

import inspect
import re
import shlex
import sys
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial, wraps
from pathlib import Path
from tempfile import gettempdir
from textwrap import fill
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, get_type_hints

import numpy as np

from accelcal_cli.core.errors import AccelcalError, Reason, UsageError, counted, did_you_mean
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import PoseSettings, Settings, setting_of
from accelcal_cli.core.system import folder_start
from accelcal_cli.formats import all_formats
from accelcal_cli.optimize import all_optimizers
from accelcal_cli.output import sentences
from accelcal_cli.pipeline.options import option_fields

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


def no_such_attribute(of: str | type, name: str, known: list[str]) -> AttributeError:
    """Return the error of a name that the module, or a class, has not, with what to type."""
    what, hints = (of, HINTS) if isinstance(of, str) else (f"a {of.__name__}", OF_OBJECTS)
    typed = next((said for pattern, said in hints.items() if re.fullmatch(pattern, name)), None)
    said = f"type {typed}" if typed else did_you_mean(name, [one for one in known if one[0] != "_"])
    shown = None if name.startswith("_") else said
    return AttributeError("; ".join(filter(None, [f"{what} has no attribute {name!r}", shown])), name=name)


class Answering:
    """An object that answers the name of an attribute that it has not with what to type."""

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            raise no_such_attribute(type(self), name, dir(self))


def no_such_option(name: str, known: list[str]) -> TypeError:
    """Return the error of a keyword that a function has not, with the one that was meant."""
    ours = next((one for one, others in KEYWORDS.items() if name.lower() in (one, *others)), "")
    said = f"did you mean {ours!r}?" if ours in known else ELSEWHERE.get(ours) or did_you_mean(name, known)
    return TypeError("; ".join(filter(None, [f"there is no option {name!r}", said])))


# How the public functions are called.

P = ParamSpec("P")
R = TypeVar("R")

FLAG = ("bool", "bool | None")
"""Annotations of keywords that switch something on."""

VALUE = r"(?:'[^']*'|(?:[\w@%+=/-]|[.,:](?=[\w%+-]))+)"
"""The value of an option; a full stop or colon after it is the sentence's."""

PLACE = r"(?:'[^']*'|[A-Z]{2,}\b|[^\s;,)`']*[./][^\s;,)`']*[\w*]|[^\s;,)`']+(?= -(?:-|[Rd] )))"
"""A value of a command itself."""

SHORT = r",?(?: or)?(?: a name)? with -[do]\b"
"""The way to name an output at a terminal."""


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
    flags = [one.name for one in given if one.annotation in FLAG]
    positional = sum(one.kind is not keyword for one in given)

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, value in kwargs.items():
            if name not in known:
                raise no_such_option(name, known)
            if name in flags and not isinstance(value, bool):
                other = "; did you mean executor=?" if hasattr(value, "submit") else ""
                raise TypeError(f"{name} is True or False, not {value!r:.60}{other}")
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
    source = inspect.getsource(sys.modules[module])
    for kind, base, body in re.findall(r"^class (\w+)\((\w+).*?:\n(.*?)(?=^class |\Z)", source, re.S | re.M):
        own = re.findall(r'^    (\w+): [^\n]*\n    """(.*?)"""$', body, re.S | re.M)
        found[kind] = found.get(base, {}) | {name: " ".join(said.split()) for name, said in own}
    return found


def _with_options(text: str, kind: type | None) -> str:
    """Return a docstring with an entry for each option of a class in place of that of all."""
    if kind is None:
        return text
    try:
        said = _option_texts(kind.__module__)[kind.__name__]
    except OSError:  # the package is installed without its source
        return text
    filled = partial(
        fill, width=100, initial_indent=4 * " ", subsequent_indent=8 * " ", break_on_hyphens=False
    )
    entries = [filled(f"{name}: {one}") for name, one in said.items()]
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


@cache
def _keywords() -> dict[str, dict[str, bool]]:
    """Return the keywords of each function, and whether each is a flag."""
    import accelcal  # whole: each of its modules imports this one

    found = {}
    for name in accelcal.__all__:
        if inspect.isfunction(function := getattr(accelcal, name)):
            parameters = inspect.signature(function).parameters.items()
            found[name] = {keyword: str(one.annotation) in FLAG for keyword, one in parameters}
    return found


@cache
def _forms() -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Return the pattern of an option or a value of a command, and that of all that is typed there.

    Groups of the first: a flag; another option, what is before its value, the value; `d` or `o` with its
    value; a value of the command itself.
    """
    known = {name for one in _keywords().values() for name, flag in one.items() if flag}
    flags = "|".join(name.replace("_", "[_-]") for name in sorted(known))
    named = rf"({flags})(?![\w-])(?:=true)?|([a-z][a-z_-]*)(?:([ =])(?!-[-Rdo])({VALUE}))?"
    option = rf"(?<![\w/-])(?:(?:--|-R )(?:{named})|-([do]) ({VALUE}))"
    name = r"(?:accelcal (?P<command>[a-z-]+)|(?P<alone>calibrate|study|apply|six-pose)(?= --))"
    call = rf"`?\b{name}(?P<given>(?: (?:{option}|{PLACE}))*)`?"
    whole = rf"`(?!accelcal )[^`]*`|{call}|{option}(?: {option})*|{SHORT}"
    return re.compile(rf"{option}|({PLACE})"), re.compile(whole)


@cache
def _choices(name: str) -> tuple[str, ...]:
    """Return the words that an option may have as its value."""
    if name in ("format", "optimizer"):
        return tuple(one.name for one in (all_formats() if name == "format" else all_optimizers()))
    options = option_fields(ReadOptions, Settings) | option_fields(PoseSettings)
    return setting_of(*options[name]).choices if name in options else ()


def worded(text: str, held: str = "") -> str:
    """Return a text with functions and keywords in place of commands and options.

    A command that is not a function here, or has an option that the function has not, stays as it is.

    Args:
        held: name of a recording in memory, which a command cannot name.
    """
    return _forms()[1].sub(lambda found: _in_python(found, held), text)


def _in_python(found: re.Match[str], held: str) -> str:
    option, _ = _forms()
    if command := found["command"] or found["alone"]:
        given = [*option.finditer(found["given"])]
        return _call(command.replace("six-pose", "from_poses"), given, held) or found[0]
    if found[0].startswith("`"):
        return found[0]
    known = {name for one in _keywords().values() for name in one}
    made = [_keyword(one, known) for one in option.finditer(found[0])]
    glue = ", " if all(one and "=" in one for one in made) else " "
    return found[0] if None in made else glue.join(filter(None, made))


def _call(function: str, given: Sequence[re.Match[str]], held: str) -> str | None:
    """Return the call that a command stands for; None if there is none."""
    known = _keywords().get(function, {})
    values, more = [], []
    for one in given:
        if place := one[7] or (function == "study" and one[6]):
            plain = place.isupper() and one[7]
            values.append("..." if place == held else place if plain else repr(place.strip("'")))
        else:
            more.append(_keyword(one, known, in_call=True))
    if not known or None in more or any("*" in value for value in values):
        return None
    call = f"accelcal.{function}"
    return f"{call}({', '.join([*values, *filter(None, more)])})" if given else call


def _keyword(found: re.Match[str], known: Container[str], *, in_call: bool = False) -> str | None:
    """Return an option as a keyword, if it is a known one; None if it is not."""
    flag, name, before, value, short, output, *_ = found.groups()
    name = {"d": "folder", "o": "output"}[short] if short else (flag or name).replace("-", "_")
    value = output if short else "True" if flag else value
    if name not in known:
        return None
    if value is None:
        return f"{name}=..." if in_call else name
    chosen = value in _choices(name) or name in ("to", "sensor")  # of which any word may be the value
    if before == " " and not in_call and value.isalpha() and value.islower() and not chosen:
        return f"{name} {value}"
    plain = flag or (not chosen and re.fullmatch(r"(?!UTC)[A-Z]+|-?\d+(\.\d+)?", value))
    return f"{name}={value if plain else repr(value.strip(chr(39)))}"


def sentence(reason: Reason) -> str:
    """Return the sentence of a reason, a caution or a piece of advice, with options as keywords."""
    return worded(sentences.sentence(reason))


def check_number(name: str, value: Any, low: float, high: float, *, whole: bool = False) -> None:
    """Raise TypeError for what is not a (whole) number, and UsageError for one beyond its bounds."""
    kinds = (int, np.integer) if whole else (int, float, np.number)
    if isinstance(value, bool) or not isinstance(value, kinds):
        raise TypeError(f"{name} cannot be {value!r}")
    if not low <= value <= high:
        raise UsageError(f"{name} cannot be {value}", hint=f"possible: {low:g} to {high:g}")

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

from accelcal._hints import no_such_option
from accelcal_cli.core.errors import AccelcalError, counted
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import PoseSettings, Settings, setting_of
from accelcal_cli.core.system import folder_start
from accelcal_cli.pipeline.options import GIVEN_VALUE, field_values, not_given, option_fields

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

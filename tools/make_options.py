"""Writes accelcal/_options.py: the options of the Python functions, typed, from what the settings declare.

Run it from anywhere; `--check` only says whether the file is up to date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from textwrap import fill
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import LEARNT_PRIORS, Option, PoseSettings, Setting, Settings, setting_of

FILE = Path(__file__).resolve().parent.parent / "accelcal" / "_options.py"
HEAD = '''"""The options of the functions, as keywords with types. tools/make_options.py writes this file.

An option that is left out, or None, has its default.
"""

from __future__ import annotations

from datetime import datetime
from os import PathLike
from typing import Literal, TypedDict

Columns = str | tuple[str | int, str | int, str | int] | list[str] | list[int]
'''
TYPES = {
    "columns": "Columns", "gyro_columns": "Columns", "layout": "str | PathLike[str]",
    "start": "str | datetime",
    "stillness_axis": 'Literal["x", "y", "z"]',
}  # fmt: skip
"""Types of options that take more, or other things, than their field."""

UNITS = {
    "HZ": "Hz", "SECONDS": "s", "MG": "mg", "DEGREES": "degrees", "METRES": "m", "PERCENT": "%",
}  # fmt: skip
ENDINGS = {"_g": "g", "_seconds": "s", "_degrees": "degrees"}
FITTED = ("optimizer", "model", "temperature", "latitude", "altitude_m", "max_error_mg", "strict")
POSED = ("unchecked", "segment_seconds", "stillness_threshold_g", "longest_gap_s", "face_degrees",
         "max_damage_percent", "max_error_mg", "latitude", "altitude_m")  # fmt: skip


OPTION = re.compile("--([a-z][a-z-]*)")


def classes() -> Iterable[str]:
    """Yield the source of each class of options."""
    method = [one.name for one in fields(Settings) if one.name != "prior"]
    own = tuple(name for name in setting_of(Settings, "prior").choices if name not in LEARNT_PRIORS)
    reading = [one.name for one in fields(ReadOptions)]
    yield made("ReadingOptions", "How a recording is read.", ReadOptions, reading)
    yield made("MethodOptions(ReadingOptions)", "How a recording is read and fitted.", Settings, method)
    yield made("CalibrationOptions(MethodOptions)", "Options of `calibrate`.", Settings, ["prior"], own)
    yield made("StudyOptions(MethodOptions)", "Options of `study` for each recording.", Settings, ["prior"])
    yield made("FitOptions", "Options of `fit`.", Settings, [*FITTED, "prior"], own)
    yield made("PoseOptions(ReadingOptions)", "Options of `from_poses`.", PoseSettings, POSED)


def made(head: str, title: str, kind: Any, names: Iterable[str], priors: tuple[str, ...] = ()) -> str:
    """Return a class with those of the fields that an option sets."""
    name, _, base = head.removesuffix(")").partition("(")
    lines = [f"class {name}({base or 'TypedDict'}, total=False):", f'    """{title}"""', ""]
    for field in names:
        declared = setting_of(kind, field)
        if declared.option is not None:
            lines += [entry(kind, field, declared, declared.option, priors), ""]
    return "\n".join(lines)


def entry(kind: Any, field: str, declared: Setting, option: Option, priors: tuple[str, ...]) -> str:
    """Return one key with its type, and with help, unit, default and bounds as its text."""
    keyword = option.keyword
    choices = priors if field == "prior" and priors else declared.choices
    of_field = kind.__dataclass_fields__[field]
    plain = str(of_field.type).removesuffix(" | None")
    hint = f"Literal[{', '.join(map(repr, choices))}]".replace("'", '"') if choices else plain
    ending = "" if keyword.startswith("lsb_per_") else keyword[keyword.rfind("_") :]
    unit = UNITS.get(option.metavar or "") or ENDINGS.get(ending, "")
    low, high = option.bounds or (declared.low, declared.high)
    bounds = [] if low is None or hint == "bool" or keyword in TYPES else [bounded(low, high, option)]
    default = option.default or ("" if of_field.default in (None, True, False) else str(of_field.default))
    known = [f"default: {default}"] if default and keyword not in TYPES else []
    about = f" ({'; '.join([*bounds, *known])})" if bounds or known else ""
    said = OPTION.sub(lambda one: one[1].replace("-", "_"), f"{option.help.rstrip('.')}{about}.")
    text = f'"""{said if not unit else f"[{unit}] {said}"}"""'
    shown = fill(text, 106, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False)
    return f"    {keyword}: {TYPES.get(keyword, hint)} | None\n{shown}"


def bounded(low: float, high: float | None, option: Option) -> str:
    """Write the bounds of a number."""
    least = f"above {option.above:g}" if option.above is not None else f"{low:g}"
    return f"{least}, at most {high:g}" if option.above is not None else f"{least} to {high:g}"


def source() -> str:
    """Return what the file should hold."""
    return "\n\n".join([HEAD, *classes()]).rstrip() + "\n"


if __name__ == "__main__":
    if "--check" not in sys.argv:
        FILE.write_text(source(), "utf-8")
    elif FILE.read_text("utf-8") != source():
        raise SystemExit("accelcal/_options.py is out of date: run python tools/make_options.py")

"""Damaged files that state how recordings are read: `study.toml` of a folder, `NAME.toml` of one, a table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from tests.fuzz import command
from tests.fuzz.blind import blind

if TYPE_CHECKING:
    from tests.fuzz.engine import Tally

KEYS = (
    *(
        "unit",
        "timezone",
        "sensor",
        "columns",
        "gyro_columns",
        "lsb_per_g",
        "rate",
        "start",
        "shift",
        "layout",
    ),
    *(
        "time_format",
        "date_format",
        "time-column",
        "format",
        "force_timezone",
        "exclude",
        "sensr",
        "",
        "\u202e",
    ),
)
VALUES = (
    *(
        '"each"',
        '"all"',
        '"left"',
        '"g"',
        '"Europe/Berlin"',
        '"nowhere/x"',
        '["x", "y", "z"]',
        '["x"]',
        '"x"',
    ),
    *(
        "[]",
        "25",
        "-1",
        "0",
        "nan",
        "inf",
        "1e400",
        "true",
        "2024-03-04T00:00:00",
        "{}",
        '"\\u0000"',
        '"csv"',
    ),
    *(
        '"%Y-%m-%d"',
        '"%"',
        '"ms"',
        '"../x.toml"',
        "99999999999999999999",
        '"' + "a" * 3000 + '"',
        "[[1]]",
        "x",
    ),
)
PATTERNS = ('"*"', '"a.csv"', '"sub/*.csv"', '"["', '"**"', '""', '"/etc/*"', '"' + "*a" * 50 + '"')


def rows(sensors: tuple[str, ...]) -> str:
    """A short table of sensors that take turns."""
    lines = ["time,x,y,z,sensor"]
    for row in range(120):
        lines += [
            f"{1_709_510_400 + row / 25:.2f},0.01,{row % 7 / 100},1.0{row % 5},{one}" for one in sensors
        ]
    return "\n".join(lines) + "\n"


def stated(random: Random) -> bytes:
    """Options by pattern, some of them odd."""
    lines = []
    if random.random() < 0.3:
        lines.append(f"exclude = {random.choice(VALUES)}")
    for _ in range(random.choice([0, 1, 1, 2, 5])):
        lines.append(f"[{random.choice(PATTERNS)}]")
        lines += [
            f'"{random.choice(KEYS)}" = {random.choice(VALUES)}' for _ in range(random.choice([0, 1, 1, 3]))
        ]
    data = "\n".join(lines).encode()
    return blind(data, random) if data and random.random() < 0.25 else data


def rules(folder: Path) -> Callable[[Random, int, Path, Tally], tuple[bytes, str, str | None]]:
    """Tries mutants of study.toml, and of a.toml next to a recording."""
    study = folder / "given"
    (study / "sub").mkdir(parents=True, exist_ok=True)
    (study / "a.csv").write_text(rows(("left", "right")))
    (study / "sub" / "b.csv").write_text(rows(("0",)))

    def attempt(random: Random, number: int, folder: Path, tally: Tally) -> tuple[bytes, str, str | None]:
        path = study / ("study.toml" if number % 3 else "a.toml")
        for one in (study / "study.toml", study / "a.toml"):
            one.unlink(missing_ok=True)
        data = stated(random)
        path.write_bytes(data)
        ran = command.run(["study", "--dry-run", study, "-d", folder / "out"])
        tally.refused += ran.code != 0
        return data, path.name, command.wrong(ran)

    return attempt

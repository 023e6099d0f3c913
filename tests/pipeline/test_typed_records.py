"""Records back from JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.settings import DEFAULT, PAPER, Settings
from accelcal_cli.pipeline.options import restored


@dataclass(frozen=True)
class Inner:
    number: int = 1
    other: int = 2


@dataclass(frozen=True)
class Record:
    whole: int = 1
    real: float = 1.5
    word: str = "a"
    flag: bool = False
    maybe: float | None = None
    pair: tuple[str, str] | None = None
    many: tuple[int, ...] = ()
    place: Path | None = None
    inner: Inner | None = None


@pytest.mark.parametrize("record", [DEFAULT, PAPER, Settings(latitude=-5.5, folds=7)])
def test_settings_survive_json(record: Settings) -> None:
    back = restored(Settings, json.loads(json.dumps(asdict(record))))
    assert (back.record, back.missing, back.unknown) == (record, (), ())


def test_reading_options_survive_json() -> None:
    options = ReadOptions(rate_hz=25.0, columns=("a", "b", "c"), timezone="UTC")
    assert restored(ReadOptions, json.loads(json.dumps(asdict(options)))).record == options


def test_missing_and_unknown_keys_are_told() -> None:
    back = restored(Record, {"whole": 3, "later": 1, "many": [1, 2], "place": "x", "real": 2})
    assert back.record == Record(whole=3, many=(1, 2), place=Path("x"), real=2.0)
    assert type(back.record.real) is float
    assert back.missing == ("word", "flag", "maybe", "pair", "inner")
    assert back.unknown == ("later",)


def test_a_record_within_a_record_comes_back() -> None:
    made = Record(inner=Inner(3, 4))
    assert restored(Record, json.loads(json.dumps(asdict(made)))).record == made
    assert restored(Record, {"inner": None}).record.inner is None
    with pytest.raises(ValueError, match="inner cannot be"):
        restored(Record, {"inner": {"number": 1, "other": "x"}})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("inner", 1), ("inner", {}), ("inner", []),
        ("inner", {"number": 1}), ("inner", {"number": 1, "other": 2, "later": 3}),
        ("whole", 1.0), ("whole", True), ("whole", None), ("whole", "1"), ("whole", []),
        ("real", "1"), ("real", True), ("real", float("nan")), ("real", float("inf")), ("real", {}),
        ("word", 1), ("word", None), ("flag", 1), ("flag", "yes"),
        ("maybe", "x"), ("maybe", [1.0]), ("pair", "ab"), ("pair", ["a"]), ("pair", ["a", 1]),
        ("pair", {"a": 1}), ("many", 1), ("many", ["a"]), ("many", [1.5]), ("place", 5),
    ],
)  # fmt: skip
def test_another_type_is_an_error_with_the_name(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{name} cannot be"):
        restored(Record, {name: value})

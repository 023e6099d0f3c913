"""Objects as plain values and back: what is kept, what stays shared, and what is refused."""

from __future__ import annotations

import json
from collections import Counter, defaultdict, deque
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.clock import UniformClock
from accelcal_cli.core.fixed import to_fixed
from accelcal_cli.core.freeze import ThawError, frozen, thawed
from accelcal_cli.core.recording import Validity

VALUES = [
    None, True, -(1 << 70), 0.1, float("inf"), "grün\0", b"\0\xff", (1, ("a",)), [1, [2]],
    {(1, 2): [3], "a": {}}, {3, 1}, frozenset({2}), Fraction(1, 3), deque([1]), Counter("aab"),
    Validity.CLIPPED, np.int16(-3), UniformClock(1, 2, Fraction(100, 3)), to_fixed,
]  # fmt: skip


def again(value: Any) -> Any:
    return thawed(json.loads(json.dumps(frozen(value))))


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_value_comes_back(value: Any) -> None:
    found = again(value)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("kind", ["<i2", "<i8", "<u8", "|u1", "|b1", "<f8", "<f4"])
@pytest.mark.parametrize("shape", [(0,), (5,), (4, 3), (3, 40), (0, 3)])
def test_an_array_comes_back_bit_for_bit(kind: str, shape: tuple[int, ...]) -> None:
    random = np.random.RandomState(1)
    raw = random.bytes(int(np.prod(shape)) * np.dtype(kind).itemsize)
    if kind == "|b1":
        raw = bytes(byte & 1 for byte in raw)
    array = np.frombuffer(raw, kind).reshape(shape)
    if kind.startswith("<f"):
        array = np.nan_to_num(array)
    found = again(array)
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert found.tobytes() == array.tobytes()


def test_a_table_of_columns_comes_back() -> None:
    table = np.zeros(3, [("run", np.int64), ("sums", np.int64, 3), ("known", np.bool_)])
    table["sums"] = np.arange(9).reshape(3, 3)
    table["known"][1] = True
    found = again(table)
    assert found.dtype == table.dtype
    assert (found == table).all()


def test_what_several_hold_stays_shared() -> None:
    rows: list[int] = []
    one, other = again([rows, {"rows": rows}])
    one.append(1)
    assert other["rows"] is one


def test_a_dictionary_of_lists_goes_on_making_them() -> None:
    found = again(defaultdict(list, {1: [2]}))
    assert found[5] == []
    assert again(defaultdict(int))["a"] == 0


def test_of_a_path_the_name_is_kept(tmp_path: Path) -> None:
    assert again(tmp_path / "a.csv") == Path("a.csv")
    assert thawed(["path", "../../etc/passwd"]) == Path("passwd")


def test_what_cannot_be_kept_is_an_error() -> None:
    for value in (open, lambda: 1, Path, object(), json.JSONDecoder(), np.array(["a"])):
        with pytest.raises((TypeError, ThawError)):
            frozen([value])


@pytest.mark.parametrize(
    "plain",
    [
        ["object", "os:PathLike"],
        ["object", "..os:PathLike"],
        ["object", "core.freeze:json"],
        ["object", "core.clock:Path"],
        ["object", "core.clock:UniformClock", "__class__", 1],
        ["object", "nothing:Nothing"],
        ["object", "core.clock:UniformClock", "__dict__", {}],
        ["object", "core.clock:UniformClock"],
        ["object", "cli.exit_codes:InterruptedBySignalError"],
        ["object", "corer:Thing"],
        ["object", "formats.cwa.reader:CwaReader", "__class__", 1],
        ["made", "core.freeze:frozen", 1],
        ["made", "formats.cwa.reader:CwaReader", ["path", "a.csv"]],
        ["function", "output.files:discard"],
        ["function", "pipeline.nothing:discard"],
        ["enum", "core.clock:UniformClock", "A"],
        ["number", "|V1000000000", 0],
        ["number", "|O", 0],
        ["array", "<U1000000000", [1], ["a"]],
        ["array", "|O", [1], ["a"]],
        ["array", "<i8", [1 << 40], []],
        ["table", 1 << 40, []],
        ["table", 1 << 40, [["a", ["array", "<i8", [1], [1]]]]],
        ["made", "collect.grid:Cells", 1, ["array", "<i8", [10, 1], [1] * 10], ["list", ["list", 0]]],
        ["fraction", 1, 0],
        ["function", "core.clock:UniformClock"],
        ["enum", "core.recording:Validity", "NOTHING"],
        ["array", "<i8", [7], [1]],
        ["same", 3],
        ["nothing"],
        [],
        {"a": 1},
    ],
    ids=str,
)
def test_what_was_never_frozen_is_refused(plain: Any) -> None:
    with pytest.raises(ThawError):
        thawed(plain)

"""Which recordings count for what."""

from __future__ import annotations

from pathlib import Path

from accelcal_cli.devices.table import Usage, read, usages
from tests.devices.made import FITTED, NOW_S, fitted, refused, write


def found(tmp_path: Path, rows: list[dict]) -> dict[str, str]:
    """Usage by path."""
    held = read(write(tmp_path, rows), NOW_S)
    return dict(zip(held.text["path"], map(str, usages(held)), strict=True))


def test_each_use(tmp_path: Path) -> None:
    good = dict.fromkeys(f"se_{name}" for name in FITTED["9"])
    rows = [
        fitted("A", 0, path="own"),
        fitted("A", None, path="no date"),
        fitted("A", -20_000, path="impossible date"),
        refused("A", 1, path="refused"),
        fitted("A", 2, path="borrowed", outcome="borrowed"),
        fitted("A", 3, good, path="good") | {"outcome": "already_good", "model": "0"},
        fitted("A", 4, good, path="no errors"),
        fitted("A", 5, path="other model", model="3", outcome="reduced_model"),
        fitted("A", 6, path="six", model="6", outcome="reduced_model"),
    ]  # fmt: skip
    assert found(tmp_path, rows) == {
        "own": "used", "no date": "undated", "impossible date": "undated", "refused": "refused",
        "borrowed": "borrowed", "good": "already good", "no errors": "no errors",
        "other model": "other model", "six": "used",
    }  # fmt: skip


def test_the_same_file_counts_once(tmp_path: Path) -> None:
    row = fitted("A", 0, path="b")
    other = fitted("B", 0, path="c") | {"sha256": row["sha256"]}
    assert found(tmp_path, [row, row | {"path": "a"}, other]) == {"a": "used", "b": "copy", "c": "used"}
    cut = refused("A", 0, path="d")
    assert found(tmp_path, [cut, cut | {"path": "e"}]) == {"d": "refused", "e": "copy"}


def test_coefficients_found_once_count_as_one_fit(tmp_path: Path) -> None:
    """Recordings whose coefficients were found together tell nothing of a change between them."""
    same = {"offset_x_g": 0.0123}
    rows = [fitted("A", 0, same), fitted("A", 30, same), fitted("A", 60), fitted("B", 0, same)]
    assert list(found(tmp_path, rows).values()) == ["shared", "shared", "used", "used"]
    copies = [rows[0], rows[0] | {"path": "copy"}]
    assert sorted(found(tmp_path, copies).values()) == ["copy", "used"]


def test_offsets_with_and_without_scale_are_not_mixed(tmp_path: Path) -> None:
    three = [fitted("A", day, model="3") for day in (0, 30, 60)]
    assert set(found(tmp_path, three).values()) == {Usage.USED}
    mixed = [*three, fitted("A", 90), fitted("A", 120, model="6")]
    assert list(found(tmp_path, mixed).values()) == ["used"] * 3 + ["other model"] * 2
    even = [*three[:2], fitted("A", 90), fitted("A", 120, model="9T")]
    assert list(found(tmp_path, even).values()) == ["other model"] * 2 + ["used"] * 2

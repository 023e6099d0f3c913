"""Names of outputs that name no file, or a file that is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run import assert_one_line, run
from tests.recordings import directions, good_raw, still_counts, write_raw

POINTS = "x,y,z\n" + "1,0,0\n0,1,0\n0,0,1\n" * 4


@pytest.mark.parametrize("name", ["", ".", "/", "..", "a/.."])
def test_an_output_without_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_raw(tmp_path / "a.raw", still_counts(directions(2)))
    (tmp_path / "points.csv").write_text(POINTS)
    before = sorted(tmp_path.rglob("*"))
    for words in (
        ("calibrate", path, "-o", name),
        ("six-pose", path, "-o", name),
        ("fit", "points.csv", "-o", name),
        ("simulate", name, "--days", 0.001),
    ):
        ran = run(*words)
        assert ran.code == 2, (words, ran)
        assert_one_line(ran, "does not name a file")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_simulated_recording_may_be_called_like_its_suffix(tmp_path: Path) -> None:
    assert run("simulate", tmp_path / ".bin", "--days", 0.001, "-q").code == 0
    assert {path.name for path in tmp_path.iterdir()} == {".bin.bin", ".bin.truth.json"}


@pytest.mark.parametrize("option", [(), ("--layout",)])
def test_a_layout_is_never_overwritten(tmp_path: Path, option: tuple[str, ...]) -> None:
    path, layout = good_raw(tmp_path), tmp_path / "good.layout.toml"
    if option:
        layout = layout.rename(tmp_path / "other")
    before = layout.read_bytes()
    given = (*option, layout) if option else ()
    ran = run("calibrate", path, "-o", layout, "--force", *given)
    assert_one_line(ran, str(layout), "would be overwritten" if option else "has to end in .parquet", code=2)
    assert layout.read_bytes() == before


def test_points_are_never_overwritten(tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    points.write_text(POINTS)
    assert run("fit", points, "-o", points, "--force").code == 2
    assert points.read_text() == POINTS

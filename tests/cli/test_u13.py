"""U13: an option that a file states is named as it stands there, and a first run has nothing unchanged."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UsageError
from accelcal_cli.pipeline.options import StatedOption, name_options_as_in_file
from tests.cli.run import run
from tests.recordings import LSB_PER_G, directions, good_raw, still_counts


def zoned(path: Path) -> Path:
    """A table whose times are in UTC and say so."""
    rows = enumerate(still_counts(directions(2)).tolist())
    path.parent.mkdir(exist_ok=True)
    lines = [
        f"2024-03-04T{at // 90000:02}:{at // 1500 % 60:02}:{at // 25 % 60:02}.{at % 25 * 40:03}+00:00,"
        + ",".join(f"{one / LSB_PER_G:.6f}" for one in row)
        for at, row in rows
    ]
    path.write_text("\n".join(["time,x,y,z", *lines]) + "\n")
    return path


@pytest.mark.parametrize("name", ["study.toml", "tz.toml"])
def test_u13_an_option_of_a_file_is_named_with_the_file(tmp_path: Path, name: str) -> None:
    path = zoned(tmp_path / "in" / "tz.csv")
    zone = 'timezone = "Europe/Berlin"\n'
    (tmp_path / "in" / name).write_text(zone if name == "tz.toml" else f'["*"]\n{zone}')
    study = run("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "--report-only")
    alone = run("inspect", path, "--config", path.with_name(name)) if name == "study.toml" else study
    origin = name if name == "tz.toml" else 'study.toml, "*"'
    for ran in (study, alone):
        assert f"omit timezone ({origin}), which is for files that state no zone" in ran.err
        assert "omit --timezone" not in ran.err and "-R force_timezone" in ran.err
    typed = run("inspect", zoned(tmp_path / "other" / "tz.csv"), "--timezone", "Europe/Berlin")
    assert "omit --timezone" in typed.err


def test_u13_only_the_whole_name_of_an_option_is_one() -> None:
    said = {"rate_hz": StatedOption("rate_hz", 25.0, "study.toml")}
    with pytest.raises(UsageError) as caught, name_options_as_in_file(said):
        raise UsageError("--rate, --rate-x and --rate are", hint="omit --rate")
    assert (
        str(caught.value) == "rate (study.toml), --rate-x and rate (study.toml) are; omit rate (study.toml)"
    )


def test_u13_nothing_is_unchanged_in_a_first_run(tmp_path: Path) -> None:
    """Two recordings would share their outputs, and are refused before any work."""
    (tmp_path / "in").mkdir()
    good_raw(tmp_path / "in", "a.raw")
    for name in ("b.raw", "b.dat"):
        shutil.copy(tmp_path / "in" / "a.raw", tmp_path / "in" / name)
        shutil.copy(tmp_path / "in" / "a.layout.toml", tmp_path / "in" / "b.layout.toml")
    words = ("study", tmp_path / "in", "-d", tmp_path / "out", "-j", 1, "--report-only")
    assert "3 recordings: 1 calibrated, 2 failed. Results" in run(*words).err
    assert "3 recordings (1 unchanged): 1 calibrated, 2 failed. Results" in run(*words).err

"""Folders whose recordings need different reading options: `study.toml` and `NAME.toml`."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

import accelcal
from tests.cli.run import run
from tests.cli.studies import results, rows, study
from tests.recordings import directions, still_counts, write_csv, write_raw

COUNTS = still_counts(directions(40))

RULES = """
["*"]
timezone = "Europe/Berlin"
["phone/*"]
unit = "mg"
["phone/odd.csv"]
unit = "m/s2"
time-column = "time"
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dump with a layout, a table in g, and two in units that no head states."""
    folder = tmp_path_factory.mktemp("mixed")
    (folder / "phone").mkdir()
    write_raw(folder / "a.raw", COUNTS)
    write_csv(folder / "g.csv", COUNTS)
    for name, factor in (("phone/mg.csv", 1000.0), ("phone/odd.csv", 9.80665)):
        write_csv(folder / name, COUNTS)
        scaled(folder / name, factor)
    return folder


@pytest.fixture
def mixed(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "in")


def scaled(path: Path, factor: float) -> None:
    """The values of a table times a factor, and columns without a unit."""
    _, *lines = path.read_text().splitlines()
    cells = [line.split(",") for line in lines]
    body = [",".join([time, *(repr(factor * float(value)) for value in xyz)]) for time, *xyz in cells]
    path.write_text("\n".join(["time,x,y,z", *body]) + "\n")


def by_name(folder: Path) -> dict[str, dict[str, str]]:
    return {row["path"]: row for row in rows(folder)}


def test_each_recording_is_read_as_the_folder_s_file_says(mixed: Path) -> None:
    (mixed / "study.toml").write_text(RULES)
    study(mixed, code=0)
    found = by_name(mixed.parent / "out")
    assert [row["outcome"] for row in found.values()] == ["calibrated"] * 4
    afters = {row["path"]: float(row["calibration_error_mg"]) for row in found.values()}
    assert max(afters.values()) < 1.05 * min(afters.values()), "the same values in four units"
    assert {row["time_zone"] for row in found.values()} == {"UTC"}
    report = json.loads((mixed.parent / "out/phone/odd.calibration.json").read_text())
    said = report["settings"]["input"]
    assert (said["unit"], said["time_column"]) == ("m/s2", "time")
    settings = json.loads((mixed.parent / "out/study.json").read_text())["settings"]
    assert settings["stated"]["study.toml"]["phone/odd.csv"] == {"unit": "m/s2", "time_column": "time"}


def test_the_result_is_that_of_the_same_options_by_hand(mixed: Path) -> None:
    (mixed / "study.toml").write_text('["phone/mg.csv"]\nunit = "mg"\n')
    study(mixed, "--include", "mg.csv")
    alone = mixed.parent / "alone"
    assert run("calibrate", mixed / "phone/mg.csv", "--unit", "mg", "-d", alone).code == 0
    together = results(mixed.parent / "out/phone")
    assert results(alone) == together


def test_a_dry_run_shows_every_choice_and_who_made_it(mixed: Path) -> None:
    (mixed / "study.toml").write_text(RULES)
    (mixed / "g.toml").write_text("rate = 25\n")
    told = study(mixed, "--dry-run")
    fields = {line.split("\t")[0].removeprefix(f"{mixed}/"): line.split("\t")[2:] for line in told.lines}
    zone = 'timezone=Europe/Berlin (study.toml, "*")'
    assert fields["g.csv"] == [f"{zone}; rate=25.0 (g.toml)"]
    assert fields["a.raw"] == [zone]
    odd = 'unit=m/s2 time_column=time (study.toml, "phone/odd.csv")'
    assert fields["phone/odd.csv"] == [f"{zone}; {odd}"]
    (line,) = study(mixed, "--dry-run", "--json", "--include", "g.csv").lines
    assert json.loads(line)["stated"]["rate_hz"] == {"value": 25.0, "from": "g.toml"}


def test_a_change_of_what_is_said_of_a_recording_makes_that_one_anew(mixed: Path) -> None:
    (mixed / "study.toml").write_text('["phone/*"]\nunit = "mg"\n')
    assert study(mixed).code == 1
    assert by_name(mixed.parent / "out")["phone/odd.csv"]["outcome"] == "refused"
    (mixed / "study.toml").write_text('["phone/*"]\nunit = "mg"\n["phone/odd.csv"]\nunit = "m/s2"\n')
    assert "3 unchanged" in study(mixed).err
    assert by_name(mixed.parent / "out")["phone/odd.csv"]["outcome"] == "calibrated"
    before = results(mixed.parent / "out")
    os.utime(mixed / "study.toml")
    assert "4 unchanged" in study(mixed).err
    assert results(mixed.parent / "out") == before


def test_what_two_say_differently_is_not_decided(mixed: Path) -> None:
    (mixed / "study.toml").write_text(RULES)
    study(mixed, "--unit", "g", code=1)
    row = by_name(mixed.parent / "out")["phone/mg.csv"]
    said = '--unit g contradicts unit=mg (study.toml, "phone/*"); say it in one place'
    assert row["message"] == said
    assert by_name(mixed.parent / "out")["g.csv"]["outcome"] == "calibrated"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '["*.csv"]\nunits = "mg"\n',
            "\"*.csv\": there is no option 'units'; did you mean 'unit'?; reading options are",
        ),
        ('["*.csv"]\nunit = "stone"\n', "\"*.csv\": unit cannot be 'stone'; possible: g, mg, m/s2, counts"),
        ('["*.csv"]\nrate = "fast"\n', "\"*.csv\": rate cannot be 'fast'"),
        ('["*.csv"]\nrate = 0\n', '"*.csv": rate cannot be 0; possible: 0.001 to 100000'),
        (
            'unit = "mg"\n',
            '\'unit\' is not a table; write it below a pattern such as ["*.csv"], or ["*"] for all',
        ),
        ('["*.csv"\n', "line 1: study.toml is not valid TOML"),
        ('["*.csv"]\ntimezone = "Mars/Olympus"\n', "study.toml: \"*.csv\": unknown time zone 'Mars/Olympus'"),
        ('["*.csv"]\nstart = "yesterday"\n', 'study.toml: "*.csv": '),
        ('["*.raw"]\nlayout = "nowhere.toml"\n', 'study.toml: "*.raw": the layout cannot be read'),
    ],
)
def test_a_file_that_says_nonsense_stops_the_study(mixed: Path, text: str, said: str) -> None:
    (mixed / "study.toml").write_text(text)
    done = study(mixed)
    assert (done.code, done.out) == (2, "")
    assert said in done.err
    assert not (mixed.parent / "out/study.csv").exists()


def test_a_file_of_another_editor_is_read_and_one_that_is_gone_is_told(mixed: Path) -> None:
    (mixed / "study.toml").write_bytes(b"\xef\xbb\xbf" + RULES.replace("\n", "\r\n").encode())
    assert study(mixed, "--dry-run").code == 0
    (mixed / "study.toml").unlink()
    (mixed / "study.toml").symlink_to(mixed / "nowhere")
    done = study(mixed)
    assert (done.code, "study.toml: study.toml cannot be read" in done.err) == (2, True)


def test_what_is_stated_and_means_nothing_is_noted_by_every_command(mixed: Path) -> None:
    (mixed / "a.toml").write_text('unit = "mg"\n')
    run("calibrate", mixed / "a.raw", "-d", mixed.parent / "alone", code=0)
    report = json.loads((mixed.parent / "alone/a.calibration.json").read_text())
    assert "--unit does not apply to format raw and was not used" in report["recording"]["notes"]


def test_a_dry_run_says_why_a_recording_would_fail(mixed: Path) -> None:
    (mixed / "g.toml").write_text('unit = "stone"\n')
    (line,) = (line for line in study(mixed, "--dry-run").lines if line.startswith(f"{mixed / 'g.csv'}\t"))
    assert "unit cannot be 'stone'" in line


def test_a_recording_s_file_that_says_nonsense_costs_that_recording(mixed: Path) -> None:
    (mixed / "g.toml").write_text("rat = 5\n")
    study(mixed, "--exclude", "phone/*", code=1)
    row = by_name(mixed.parent / "out")["g.csv"]
    assert (row["outcome"], row["exit_code"]) == ("failed", "2")
    assert "g.toml: there is no option 'rat'; did you mean 'rate'?" in row["message"]


def test_what_two_folders_say_is_kept_apart(mixed: Path) -> None:
    other = mixed.parent / "other"
    other.mkdir()
    write_csv(other / "b.csv", COUNTS)
    scaled(other / "b.csv", 1000.0)
    (mixed / "study.toml").write_text(RULES)
    (other / "study.toml").write_text('["*.csv"]\nunit = "mg"\n')
    out = mixed.parent / "out"
    assert run("study", mixed, other, "-d", out, "--report-only").code == 0
    stated = json.loads((out / "study.json").read_text())["settings"]["stated"]
    assert stated["other/study.toml"] == {"*.csv": {"unit": "mg"}}
    assert stated["in/study.toml"]["phone/*"] == {"unit": "mg"}


def test_a_pattern_that_no_file_fits_is_told(mixed: Path) -> None:
    (mixed / "study.toml").write_text('["*.cvs"]\nunit = "mg"\n')
    for more in ((), ("--dry-run",)):
        assert f'no file fits "*.cvs" of {mixed / "study.toml"}' in study(mixed, *more).err


def test_another_file_takes_the_place_of_the_folder_s(mixed: Path) -> None:
    (mixed / "study.toml").write_text('["*.csv"]\nunit = "counts"\n')
    other = mixed.parent / "other.toml"
    other.write_text(RULES)
    assert study(mixed, "--config", other).code == 0
    single = run("calibrate", mixed / "phone/mg.csv", "--config", mixed.parent / "x.toml", "-d", "no")
    assert (single.code, "x.toml: study.toml cannot be read" in single.err) == (2, True)
    by_name_alone = mixed.parent / "names.toml"
    by_name_alone.write_text('["mg.csv"]\nunit = "mg"\n')
    out = mixed.parent / "alone"
    run("calibrate", mixed / "phone/mg.csv", "--config", by_name_alone, "-d", out, code=0)


def test_every_command_reads_a_recording_as_its_own_file_says(mixed: Path) -> None:
    path = mixed / "phone/mg.csv"
    plain = run("inspect", path)
    (mixed / "phone/mg.toml").write_text('unit = "mg"\n')
    told = run("inspect", path)
    assert (plain.code, told.code) == (3, 0) or plain.out != told.out
    assert run("calibrate", path, "--report-only").code == 0
    report = accelcal.calibrate(path).report
    assert report["settings"]["input"]["unit"] == "mg"
    with accelcal.read(path) as reading:
        assert max(abs(part.xyz).max() for part in reading) < 3
    run("calibrate", path, "-d", mixed.parent / "alone")
    (mixed / "phone/mg.toml").write_text('unit = "m/s2"\n')
    again = run("verify", mixed.parent / "alone/mg.calibration.json", path)
    assert again.code == 0, "a report is made again with what it was made with"


def test_a_layout_lies_where_the_file_that_names_it_says(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    (folder / "layouts").mkdir(parents=True)
    (folder / "dumps").mkdir()
    write_raw(folder / "dumps/a.raw", COUNTS)
    (folder / "dumps/a.layout.toml").rename(folder / "layouts/logger.toml")
    (folder / "study.toml").write_text('["dumps/*"]\nlayout = "layouts/logger.toml"\n')
    assert study(folder).code == 0
    assert "1 unchanged" in study(folder).err
    text = (folder / "layouts/logger.toml").read_text()
    (folder / "layouts/logger.toml").write_text(text + "\n# looked at again\n")
    assert "unchanged" not in study(folder).err, "another layout, another result"


def test_links_to_folders_are_followed_or_named(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "in", tmp_path / "disk"
    for place in (folder, elsewhere):
        place.mkdir()
    write_raw(folder / "a.raw", COUNTS)
    write_raw(elsewhere / "b.raw", COUNTS[::-1].copy())
    (folder / "more").symlink_to(elsewhere)
    (folder / "again").symlink_to(elsewhere)
    (elsewhere / "loop").symlink_to(folder)
    done = study(folder, code=0)
    assert sorted(by_name(tmp_path / "out")) == ["a.raw", "again/b.raw"]
    assert f"the link {folder / 'more'} is not followed: {elsewhere} is gone through as it is" in done.err
    assert f"the link {folder / 'again/loop'} is not followed: {folder} is gone through as it is" in done.err


def test_a_folder_given_to_calibrate_names_study(mixed: Path) -> None:
    done = run("calibrate", mixed, code=3)
    assert f"is a folder; to calibrate the recordings in it: accelcal study {mixed} -d OUT;" in done.err

"""What a person must act on: each finding and where it is said, by a quiet run once until it changes."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.core.errors import Reason
from accelcal_cli.output import decisions, sentences
from accelcal_cli.output.decisions import MOST_LISTED, of_another_name
from accelcal_cli.studies import findings, orphans, summary
from accelcal_cli.studies.findings import Finding
from tests.cli.run import Ran
from tests.cli.studies import csv_rows, study, study_folder
from tests.recordings import directions, still_counts, write_csv, write_raw

NAMES = ("P001.raw", "site/P002.raw", "site/P003.raw")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Recordings of which a study is made, in `out` beside them."""
    folder = study_folder(tmp_path / "in", NAMES)
    night(folder, "-q", code=0)
    return folder


def night(folder: Path, *words: str, code: int | None = None) -> Ran:
    return study(folder, "--report-only", *words, code=code)


def decide(folder: Path, text: str) -> None:
    (folder.parent / "out/decisions.csv").write_text(f"recording,use,result\n{text}")


def no_exclude(folder: Path) -> None:
    decide(folder, "P001.raw,No exclude,\n")


def no_such_name(folder: Path) -> None:
    decide(folder, "P01,no,\n")


def contradiction(folder: Path) -> None:
    decide(folder, "P001.raw,no,\nP001.raw,yes,\n")


def outdated(folder: Path) -> None:
    decide(folder, "P001.raw,no,r0123456789\n")


def followed(folder: Path) -> None:
    decide(folder, "P001.raw,no,\n")
    night(folder, "-q")
    renamed(folder)
    for one in (folder.parent / "out").glob("P001.*"):
        one.unlink()


def without_data(folder: Path) -> None:
    write_raw(folder / "P004.raw", still_counts(directions(1)))
    night(folder, "-q")
    decide(folder, "P004.raw,yes,\n")


def decisions_deleted(folder: Path) -> None:
    decide(folder, "P001.raw,no,\nP002.raw,with care,\n")
    night(folder, "-q")
    (folder.parent / "out/decisions.csv").unlink()


def deleted(folder: Path) -> None:
    (folder / "site/P003.raw").unlink()


def renamed(folder: Path) -> None:
    for suffix in ("raw", "layout.toml"):
        (folder / f"P001.{suffix}").rename(folder / f"P009.{suffix}")


def unmounted(folder: Path) -> None:
    shutil.rmtree(folder / "site")
    (folder / "site").mkdir()
    (folder / "site/.DS_Store").write_text("")


def cut_short(folder: Path) -> None:
    data = gzip.compress(write_csv(folder / "P004.csv", still_counts(directions(80))).read_bytes())
    (folder / "P004.csv").unlink()
    (folder / "P004.csv.gz").write_bytes(data[: len(data) * 9 // 10])


def two_names(folder: Path) -> None:
    for suffix in ("raw", "layout.toml"):
        shutil.copy(folder / f"P001.{suffix}", folder / f"P007.{suffix}")


EVERY: dict[str, tuple[Callable[[Path], None], str]] = {
    "decision_unreadable": (no_exclude, "decisions.csv: In row 2, use is 'No exclude', which is not yes, "),
    "decision_without_recording": (no_such_name, "decisions.csv: Row 2 names P01, which is not a recording "),
    "decisions_contradict": (contradiction, "decisions.csv: Rows 2 and 3 contradict each other on P001.raw."),
    "decision_outdated": (outdated, "decisions.csv: The result of P001.raw has changed since row 2 decided "),
    "decision_followed": (followed, "decisions.csv: Row 2 excludes P001.raw, which is now called P009.raw"),
    "decision_without_data": (without_data, "decisions.csv: Row 2 decides yes on P004.raw, which has no "),
    "decisions_gone": (decisions_deleted, "decisions.csv: The file is gone, and 2 decisions with it. "),
    "recording_gone": (deleted, "site/P003.calibration.json stays, and --prune removes it: its recording "),
    "recording_renamed": (renamed, "P001.calibration.json stays, and --prune removes it: its recording P001"),
    "disk_may_be_away": (unmounted, "site: No recording of the last run is left in this folder, or it "),
    "file_cut_short": (cut_short, "P004.csv.gz: The file is cut short"),
    "copied_under_another_name": (two_names, "P007.raw: It has the same bytes as P001.raw, under another "),
}
"""Findings by code: what makes each, and how its line begins, which a run, the log and the page have."""

OTHERS = {
    "recording_elsewhere": "test_whose_study.py",
    "sensor_gone": "test_sensors.py",
    "pool_refused": "test_pool.py",
    "times_mixed": "test_time_zones.py",
}
"""Findings that are shown elsewhere."""


@pytest.mark.parametrize("code", EVERY)
def test_d2_a_quiet_night_says_it_once_and_all_else_has_it(code: str, folder: Path) -> None:
    make, start = EVERY[code]
    make(folder)
    log = folder.parent / "night.log"
    first = night(folder, "-q", "--html", "--log", str(log))
    (line,) = first.err.splitlines()
    assert line.startswith(f"accelcal: {start}")
    for words, said in ((("-q",), False), ((), True), (("-q", "--all-failures"), True), (("-q",), False)):
        assert (line in night(folder, *words).err.splitlines()) == said
    found = json.loads((folder.parent / "out/study.json").read_text())["findings"]
    text = line.removeprefix("accelcal: ")
    assert [(one["code"], one["message"]) for one in found["listed"]] == [(code, text)]
    assert (found["number"], found["rest"]) == (1, None)
    assert f"to act on: {text}" in log.read_text()
    page = (folder.parent / "out/study.html").read_text()
    begin = page.index('id="to-act-on"')
    assert start.split("'")[0] in page[begin : page.index("The whole table")].replace("&#39;", "'")


def test_every_finding_has_its_line() -> None:
    source = "".join(Path(str(one.__file__)).read_text() for one in (findings, orphans, decisions, summary))
    made = {code for code in sentences.FILES if f'"{code}"' in source}
    assert made - {"decided_by_a_person", "excluded"} == {*EVERY, *OTHERS}


def test_d2_what_changes_is_said_again_and_what_ends_is_not(folder: Path) -> None:
    no_such_name(folder)
    assert "Row 2 names P01," in night(folder, "-q").err
    decide(folder, "P001.raw,yes,\nP01,no,\n")
    assert "Row 3 names P01," in night(folder, "-q").err
    decide(folder, "P001.raw,yes,\n")
    assert night(folder, "-q").err == ""
    decide(folder, "P001.raw,yes,\nP01,no,\n")
    assert "Row 3 names P01," in night(folder, "-q").err


@pytest.mark.parametrize("text", ["recording,use\n", "recording,use\nP001.raw,no\n"])
def test_d2_decisions_that_are_gone_stay_on_the_page_until_there_is_a_file(text: str, folder: Path) -> None:
    decisions_deleted(folder)
    for _ in range(3):
        night(folder, "-q")
        held = json.loads((folder.parent / "out/study.json").read_text())["findings"]
        assert [one["values"] for one in held["listed"]] == [{"number": 2}]
    (folder.parent / "out/decisions.csv").write_text(text)
    assert night(folder, "-q").err == ""
    assert json.loads((folder.parent / "out/study.json").read_text())["findings"]["number"] == 0


@pytest.mark.parametrize("number", [MOST_LISTED, MOST_LISTED + 1, 3 * MOST_LISTED])
def test_h3_of_many_findings_the_first_are_listed_and_the_rest_is_said_once(number: int) -> None:
    many = [Finding(Reason.of("recording_gone", source=f"{at}"), f"{at} is gone") for at in range(number)]
    held = json.loads(json.dumps({"findings": findings.as_json(many)}))
    assert (held["findings"]["number"], len(held["findings"]["listed"])) == (number, MOST_LISTED)
    more = number > MOST_LISTED
    lines = list(findings.lines(many, {}))
    assert len(lines) == MOST_LISTED + more and all(new for _, new in lines)
    assert not more or lines[-1][0] == f"and {number - MOST_LISTED} more to act on"
    assert not any(new for _, new in findings.lines(many, held))
    other = [*many[:-1], Finding(Reason("recording_gone"), "another")]
    assert [line for line, new in findings.lines(other, held) if new] == [lines[-1][0] if more else "another"]


@pytest.mark.parametrize(
    "odd",
    [
        None, 3, [], {"listed": 3}, {"listed": [3, {}]}, {"listed": [], "rest": []}, {"decided": "3"},
        {"listed": [{"code": [], "message": {}, "values": 3}]},
    ],
)  # fmt: skip
def test_findings_that_others_changed_are_none(odd: Any) -> None:
    one = Finding(Reason("recording_gone"), "it is gone")
    assert list(findings.lines([one], {"findings": odd})) == [("it is gone", True)]
    assert list(findings.of_decisions(None, {"findings": odd, "decisions": odd})) == []
    gone = {"code": "decisions_gone", "message": "3", "values": {"code": odd}}
    (held,) = findings.of_decisions(None, {"findings": {"listed": [gone]}})
    assert held.as_json() == gone


@pytest.mark.parametrize(
    ("paths", "original"),
    [
        (("P001 (copy).gt3x", "P001.gt3x"), "P001.gt3x"),
        (("Copy of p1.cwa", "p1.cwa"), "p1.cwa"),
        (("a/P1.csv", "backup/P1.csv"), "a/P1.csv"),
        (("P1 - Kopie.bin", "P1 - Kopie (2).bin", "z/P1.bin"), "z/P1.bin"),
        (("backup_2024/P1.csv", "P1.csv"), "P1.csv"),
    ],
)
def test_d9_the_original_has_the_fewest_words(paths: tuple[str, ...], original: str) -> None:
    table = {path: {"sha256": "1", "device_serial": "A", "sensor": None} for path in paths}
    assert summary.copies(table) == dict.fromkeys({*paths} - {original}, original)
    assert not any(of_another_name(path, original) for path in paths)


@pytest.mark.parametrize("pair", [("1.cwa", "2.cwa"), ("P1/raw.cwa", "P2/raw.cwa"), ("anna.csv", "bob.csv")])
def test_d9_two_people_are_of_another_name(pair: tuple[str, str]) -> None:
    assert of_another_name(*pair) and of_another_name(*pair[::-1])


def test_d9_of_two_people_the_excluded_one_settles_it(folder: Path) -> None:
    """Whichever it is: the other one counts, and a pair is said once."""
    two_names(folder)
    assert night(folder).err.count("P007.raw: ") == 1
    for excluded, other in (("P007.raw", "P001.raw"), ("P001.raw", "P007.raw")):
        decide(folder, f"{excluded},no,\n")
        assert night(folder, "-q").err == ""
        copies = {row["path"]: row["copy_of"] for row in csv_rows(folder.parent / "out")}
        assert (copies[other], copies[excluded]) == ("", other)
        assert json.loads((folder.parent / "out/study.json").read_text())["uses"] == {"yes": 3}

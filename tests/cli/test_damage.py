"""`-R max_damage`: a recording of which damage has taken too much is refused, with a report."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.cli.run import assert_one_line, codes, files, report_of, run, told, verify
from tests.formats import make_flash
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts
from tests.studies.mixture import simulated


def dump(path: Path, spoiled: int) -> Path:
    """A recording that can be calibrated, `spoiled` of every ten pages overwritten."""
    made = make_flash.pages(still_counts(directions(60)), RATE_HZ)
    pages = [bytes(512) if index // 57 % 10 < spoiled else page for index, page in enumerate(made)]
    path.write_bytes(make_flash.header(RATE_HZ, LSB_PER_G) + b"".join(pages) + b"\xff" * 512_000)
    return path


def test_more_than_the_limit_is_refused_with_a_report(tmp_path: Path) -> None:
    path = dump(tmp_path / "a.bin", 6)
    assert_one_line(run("calibrate", path, "-q"), "lost to damage", "50 %", "-R max_damage", code=4)
    assert files(tmp_path) == ["a.bin", "a.calibration.json", "a.quality.json"]
    report = report_of(tmp_path / "a.calibration.json")
    health = report["file_health"]
    lost = sum(1 for index in range(563) if index // 57 % 10 < 6)
    assert health["lost_bytes"] == lost * 512
    assert health["lost_percent"] == pytest.approx(100 * lost / 563, abs=1e-4)
    assert (report["outcome"], report["reason"], report["calibration"]) == ("refused", "damaged", None)
    assert codes(report["advice"]) == ["copy_again", "allow_damage"]
    assert report["settings"]["max_damage_percent"] == 50.0


@pytest.mark.nightly
def test_the_limit_can_be_raised_and_lowered(tmp_path: Path) -> None:
    path = dump(tmp_path / "a.bin", 6)
    assert run("calibrate", path, "-R", "max_damage=70").code == 0
    ran, found = verify(tmp_path / "a.calibration.json", path)
    assert (ran.code, found["result"]) == (0, "identical")
    whole = dump(tmp_path / "b.bin", 1)
    assert run("calibrate", whole, "-R", "max_damage=5").code == 4
    assert report_of(tmp_path / "b.calibration.json")["calibration"] is None
    assert run("calibrate", whole).code == 0
    assert run("calibrate", whole, "-R", "max_damage=101").code == 2


def test_a_refusal_is_reproduced_by_verify(tmp_path: Path) -> None:
    path = dump(tmp_path / "a.bin", 6)
    run("calibrate", path)
    ran, found = verify(tmp_path / "a.calibration.json", path)
    assert (ran.code, found["result"]) == (0, "identical")


def test_apply_refuses_too(tmp_path: Path) -> None:
    good, bad = dump(tmp_path / "good.bin", 0), dump(tmp_path / "bad.bin", 6)
    assert run("calibrate", good).code == 0
    words = ("apply", "--coefficients", tmp_path / "good.calibration.json", bad)
    assert_one_line(run(*words, "-q"), "lost to damage", code=4)
    report = report_of(tmp_path / "bad.calibration.json")
    assert (report["calibration"], report["coefficients"]["recording_path"]) == (None, good.name)
    assert not (tmp_path / "bad.calibrated.parquet").exists()
    assert run(*words, "-R", "max_damage=99").code == 0


def test_inspect_predicts_it(tmp_path: Path) -> None:
    ran = run("inspect", dump(tmp_path / "a.bin", 6), code=0)
    assert "prediction   refused" in ran.out
    assert "-R max_damage" in ran.out


@pytest.mark.parametrize("kind", ["gt3x", "geneactiv", "raw"])
def test_a_stump_is_told_to_be_copied_again_and_a_short_recording_is_not(tmp_path: Path, kind: str) -> None:
    """What is left of it holds too few postures, as the whole of a short one does."""
    whole = simulated(tmp_path / "whole", kind, 1, 0.02)
    stump = whole.with_name(f"stump{''.join(whole.suffixes)}")
    stump.write_bytes(whole.read_bytes()[: whole.stat().st_size * 4 // 5 + 1])
    if kind == "raw":
        stump.with_name("stump.layout.toml").write_text(whole.with_name("whole.layout.toml").read_text())
    for path, cut in ((whole, False), (stump, True)):
        ran = run("calibrate", path, "--report-only", "--strict")
        report = report_of(path.with_name(f"{path.name.partition('.')[0]}.calibration.json"))
        advice = codes(report["advice"])
        assert (ran.code, "more_orientations" in advice, "copy_again" in advice) == (4, True, cut)
        said = told(report, "cut_short" if cut else advice[0])  # which says to copy it again, too
        assert said in ran.err and (advice[0] == "copy_again") == cut
        if kind == "gt3x":
            assert ("The file is cut short" in run("inspect", path).out) == cut


def test_gaps_that_run_past_the_year_9999_are_reported(tmp_path: Path) -> None:
    """28 rows a page at 0.001 Hz, 999 pages missing between each two: 324 days."""
    pages = [struct.pack("<I", 1000 * k) + struct.pack("<84h", *[0, 0, 256] * 28) for k in range(3)]
    (tmp_path / "a.raw").write_bytes(b"".join(pages))
    axes = [f'{axis} = {{ offset = {2 * k}, type = "int16" }}' for k, axis in enumerate("xyz")]
    keys = ["rate_hz = 0.001", "lsb_per_g = 256", "page_bytes = 172", "page_header_bytes = 4"]
    start, page = 'start_time = "9999-12-31T20:00:00"', '[page]\nsequence = { offset = 0, type = "uint32" }'
    (tmp_path / "a.layout.toml").write_text("\n".join(["[dump]", *keys, start, "[fields]", *axes, page]))
    assert run("calibrate", tmp_path / "a.raw", "-q").code == 4
    gaps = report_of(tmp_path / "a.calibration.json")["recording"]["gaps"]
    assert [gap["start_time"][:6] for gap in gaps] == ["+10000", "+10000"]

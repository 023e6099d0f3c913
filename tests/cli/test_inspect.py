"""`accelcal inspect`: what a recording holds, and what calibrating it would give."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import assert_one_line, run, run_process
from tests.recordings import LSB_PER_G, directions, good_csv, still_counts, write_csv, write_raw


def test_people_see_rate_duration_and_prediction(tmp_path: Path) -> None:
    ran = run("inspect", write_raw(tmp_path / "a.raw", still_counts(directions(60))))
    assert (ran.code, ran.err) == (0, "")
    for part in ("25 Hz", "256 counts per g", "45000 samples", "0.50 h", "prediction   calibrated: "):
        assert part in ran.out


def test_json_has_one_object_a_recording(tmp_path: Path) -> None:
    ran = run("inspect", "--json", "--full", good_csv(tmp_path), good_csv(tmp_path, "b.csv"))
    shown = [json.loads(line) for line in ran.lines]
    assert [item["recording"]["samples"] for item in shown] == [45_000, 45_000]
    assert shown[0]["recording"]["start_time"] == "2024-03-04T00:00:00.000000"
    assert shown[0]["recording"]["duration_s"] == 1800.0
    assert shown[0]["read"]["whole"] is True
    assert shown[0]["prediction"]["outcome"] == "calibrated"


def test_a_small_file_is_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_raw(tmp_path / "a.raw", still_counts(directions(60)))
    for most, whole in ((path.stat().st_size, True), (path.stat().st_size - 1, False)):
        monkeypatch.setattr("accelcal_cli.pipeline.inspect.SMALL_BYTES", most)
        assert json.loads(run("inspect", "--json", path).out)["read"]["whole"] is whole


def test_people_see_what_the_values_are_like(tmp_path: Path) -> None:
    counts = still_counts(directions(60))
    path = write_raw(tmp_path / "a.raw", counts)
    (values,) = [json.loads(line)["values"] for line in run("inspect", "--json", "--full", path).lines]
    g = counts / LSB_PER_G
    assert [row["g"] for row in values["first"]] == np.round(g[:3], 4).tolist()
    assert values["first"][1]["time"] == "2024-03-04T00:00:00.040000"
    for name, expected in (("low_g", g.min(axis=0)), ("mean_g", g.mean(axis=0)), ("high_g", g.max(axis=0))):
        assert values[name] == pytest.approx(expected.tolist(), abs=6e-5)
    assert values["rest"]["windows"] > 100 and 0.9 < values["rest"]["median_g"] < 1.1
    shown = run("inspect", path).out
    assert shown.count("2024-03-04T00:00:00.0") == 4 and "  values       x -" in shown
    assert "  at rest      |a|: median " in shown


def test_it_writes_nothing(tmp_path: Path) -> None:
    run("inspect", good_csv(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["good.csv"]


def test_a_hopeless_recording_is_predicted_to_be_refused(tmp_path: Path) -> None:
    ran = run("inspect", write_csv(tmp_path / "a.csv", still_counts(directions(1))), code=0)
    assert "prediction   refused" in ran.out


def test_an_unreadable_recording_has_its_code_and_line(tmp_path: Path) -> None:
    assert_one_line(run("inspect", tmp_path / "absent.cwa"), "absent.cwa", code=3)
    assert run("inspect", tmp_path / "absent.cwa", good_csv(tmp_path)).code == 1


@pytest.mark.nightly
def test_standard_input_is_read_like_a_file(tmp_path: Path) -> None:
    data = good_csv(tmp_path).read_bytes()
    ran = run_process("inspect", "--json", "-", stdin=data)
    assert (ran.code, ran.err) == (0, "")
    shown = json.loads(ran.out)
    assert (shown["recording"]["path"], shown["recording"]["samples"]) == ("-", 45000)
    assert shown["prediction"]["outcome"] == "calibrated"
    layout = write_raw(tmp_path / "a.raw", still_counts(directions(60))).with_name("a.layout.toml")
    raw = run_process("inspect", "--layout", layout, "-", stdin=(tmp_path / "a.raw").read_bytes())
    assert "45000 samples" in raw.out


def test_standard_input_that_cannot_be_read_has_its_name() -> None:
    assert_one_line(run_process("inspect", "-", stdin=b""), "accelcal: -,", "is empty", code=3)
    assert run("inspect", "-", "-").code == 2


def test_a_look_at_pieces_predicts_what_the_default_optimizer_finds(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    words = ("inspect", "--json", path)
    quick, named = (
        json.loads(run(*words, *more).out)["prediction"] for more in ((), ("--optimizer", "fixed32"))
    )
    assert quick["message"] == named["message"]
    assert quick["holdout"]["after_mg"]["mean"] == pytest.approx(
        named["holdout"]["after_mg"]["mean"], abs=2e-3
    )


def test_the_clock_and_a_change_of_its_zone(tmp_path: Path) -> None:
    path = good_csv(tmp_path)
    lines = path.read_text().splitlines()
    kept = [line for number, line in enumerate(lines) if number // 250 != 40]
    moved = "\n".join(kept).replace("2024-03-04T00:", "2024-03-31T01:")
    path.write_text(moved.replace("T01:2", "T02:2") + "\n")
    zone = ("--timezone", "Europe/Berlin")
    shown = json.loads(run("inspect", "--json", "--full", path, *zone).out)
    clock, notes = shown["file_health"]["clock"], shown["recording"]["notes"]
    assert (clock["rate_hz_nominal"], clock["drift_s_per_day"], clock["backward"]) == (25.0, 0.0, 0)
    assert (clock["gaps"], clock["gap_seconds"]) == (2, 3600.04 + 10.04)
    assert clock["dst_change"]["time"] == "2024-03-31T02:00:00.000000+01:00"
    assert clock["dst_change"]["note"] in notes
    in_pieces = run("inspect", path, *zone).out
    assert "clocks in Europe/Berlin were put forward by 1 h" in in_pieces
    assert json.loads(run("inspect", "--json", path).out)["file_health"]["clock"]["dst_change"] is None


def test_u12_several_recordings_are_a_table(tmp_path: Path) -> None:
    good = good_csv(tmp_path, "good.csv")
    raw = write_raw(tmp_path / "few.raw", still_counts(directions(1)))
    (tmp_path / "bad.cwa").write_bytes(b"nothing" * 200)
    ran = run("inspect", good, raw, tmp_path / "bad.cwa")
    head, line, *rows = ran.lines
    assert (ran.code, len(rows), set(line)) == (1, 3, {"-", " "})
    assert " ".join(head.split()) == "recording format device start hours Hz range g prediction"
    cells = [row.split() for row in rows]
    assert [row[0] for row in cells] == [str(good), str(raw), str(tmp_path / "bad.cwa")]
    assert [row[1] for row in cells] == ["csv", "raw", "-"]
    assert [row[-1] for row in cells] == ["calibrated", "refused", "failed"]
    found = [json.loads(text) for text in run("inspect", good, raw, "--json").lines]
    for row, one in zip(cells, found, strict=False):
        about = one["recording"]
        assert f"{about['duration_s'] / 3600:.2f}" in row and f"{about['sample_rate_hz']:.5g}" in row
    assert len(ran.err.splitlines()) == 1 and "bad.cwa" in ran.err


def test_u12_long_shows_all_about_each(tmp_path: Path) -> None:
    good = good_csv(tmp_path, "good.csv")
    raw = write_raw(tmp_path / "few.raw", still_counts(directions(1)))
    alone = [run("inspect", path).out for path in (good, raw)]
    assert run("inspect", good, raw, "--long").out == "".join(alone)
    assert run("inspect", good, "--long").out == alone[0]


def test_u12_the_table_fits_a_terminal_of_100_columns(tmp_path: Path) -> None:
    """Names lose their middle; where nobody looks, as in a pipe, they are whole."""
    names = [f"{'a long name of a recording ' * 4}{number}.csv" for number in range(2)]
    paths = [good_csv(tmp_path, name) for name in names]
    assert str(paths[1]) in run("inspect", *paths).out
    lines = run("inspect", *paths, terminal=True).lines
    assert max(map(len, lines)) == 100
    assert [line.split("  ")[0][-5:] for line in lines[2:]] == ["0.csv", "1.csv"]

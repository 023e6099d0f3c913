"""`accelcal evaluate simulation` and `accelcal evaluate gravity` from outside."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.cli.evaluate import PARTS
from accelcal_cli.core.version import __version__
from tests.cli.run import assert_one_line, run, run_process

ROOT = Path(__file__).resolve().parent.parent.parent
Capture = pytest.CaptureFixture[str]
QUICK = ("evaluate", "simulation", "--cases", 3, "--points", "18", "--optimizer")
NINE = ["k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy", "ox", "oy", "oz"]


def timeless(text: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(text)
    for table in found["tables"]:
        for method in table["methods"]:
            assert method.pop("seconds_per_fit") > 0
    return found


@pytest.mark.parametrize("name", sorted(PARTS))
def test_each_evaluation_has_help_and_is_documented(capsys: Capture, name: str) -> None:
    ran = run(capsys, "evaluate", name, "--help")
    assert ran.code == 0 and f"Usage: accelcal evaluate {name}" in ran.out
    documents = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    assert any(f"accelcal evaluate {name}" in path.read_text() for path in documents)


def test_the_groups_help_lists_them_and_imports_nothing_heavy(capsys: Capture) -> None:
    assert all(name in run(capsys, "evaluate", "--help").out for name in PARTS)
    code = (
        "import sys; from accelcal_cli.cli.main import cli\n"
        "cli.main(['evaluate', '--help'], standalone_mode=False)\n"
        "sys.exit('numpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_the_table_has_the_paper_the_bound_and_the_methods(capsys: Capture) -> None:
    ran = run(capsys, *QUICK, "fixed32:paper", "--optimizer", "ellipsoid")
    assert ran.code == 0 and ran.err == ""
    (paper, _) = [line.split() for line in ran.lines if line.startswith("paper, Table 2")]
    assert paper[3:12] == ["2.98", "3.18", "2.47", "14.9", "14.2", "14.5", "2.39", "2.54", "2.04"]
    for part in (
        "18 points, noise 1 mg",
        "18 points, noise 5 mg",
        "bound",
        "ellipsoid (six)",
        "90150",
        "0.704",
    ):
        assert part in ran.out
    assert max(map(len, ran.lines)) < 120
    assert not any(line.endswith(" ") for line in ran.lines)


def test_json_holds_all_of_it(capsys: Capture) -> None:
    found = timeless(run(capsys, *QUICK, "fixed32:paper", "--json").out)
    assert found["accelcal_version"] == __version__
    assert found["protocol"] == {
        "cases": 3, "seed": 1, "points": [18], "noise_mg": [1.0, 5.0], "selection": "subsets",
        "gauge": "lower",
    }  # fmt: skip
    one, five = found["tables"]
    assert one["published"]["mean_abs_error"]["k_yx"] == 1.49e-3
    assert five["published"]["sd_abs_error"]["oz"] == 7.76e-4
    assert list(one["bound"]) == NINE
    (method,) = one["methods"]
    assert (method["method"], method["model"], method["iterations"]) == ("fixed32:paper", "9", 50)
    assert method["operations"] == {"additions": 90_150, "multiplications": 90_150}
    assert method["predicted_seconds"]["ATmega328"] == 0.7043
    assert (method["cases"], method["failed"], method["failures"]) == (3, 0, {})


def test_json_is_the_same_for_the_same_seed(capsys: Capture) -> None:
    one = timeless(run(capsys, *QUICK, "gauss-newton", "--json", "--seed", 5).out)
    assert one == timeless(run_process(*QUICK, "gauss-newton", "--json", "--seed", 5).out)
    assert one["tables"] != timeless(run(capsys, *QUICK, "gauss-newton", "--json").out)["tables"]


def test_csv_has_the_same_figures_as_json(capsys: Capture) -> None:
    rows = list(csv.DictReader(io.StringIO(run(capsys, *QUICK, "closest-point", "--csv").out)))
    found = timeless(run(capsys, *QUICK, "closest-point", "--json").out)
    assert len(rows) == 2 * 3 * 9
    for row in rows:
        (table,) = [item for item in found["tables"] if item["noise_mg"] == float(row["noise_mg"])]
        known = {"paper": table["published"], "bound": {"mean_abs_error": table["bound"]}}
        source = known.get(row["source"], table["methods"][0])
        for key in ("mean_abs_error", "sd_abs_error"):
            expected = source.get(key, {}).get(row["parameter"])
            assert (float(row[key]) if row[key] else None) == expected


def test_failures_are_named(capsys: Capture) -> None:
    words = (
        "evaluate", "simulation", "--cases", 2, "--noise-mg", 100, "--points", 1152, "--optimizer", "fixed16",
    )  # fmt: skip
    ran = run(capsys, *words)
    assert ran.code == 0
    assert "1152 points, 100 mg, fixed16: 2 x the cost leaves 32 bits" in ran.out
    assert json.loads(run(capsys, *words, "--json").out)["tables"][0]["methods"][0]["ratio_to_bound"] is None


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--points", "20"), "multiple of 9"),
        (("--points", "18,"), None),
        (("--points", "few"), "not a list of numbers"),
        (("--points", "5"), "not between 9 and 8192"),
        (("--noise-mg", "nan"), "not between"),
        (("--optimizer", "gradient"), "unknown optimizer"),
        (("--optimizer", "ellipsoid:paper"), "no settings of profile"),
        (("--cases", "0"), "0 is not in the range"),
        (("--json", "--csv"), None),
    ],
)
def test_wrong_words_are_answered(capsys: Capture, words: tuple[str, ...], part: str | None) -> None:
    ran = run(capsys, "evaluate", "simulation", "--cases", "1", "--points", "18", *words)
    if part is None:
        assert ran.code == 0
    else:
        assert ran.code == 2
        assert part in ran.err.splitlines()[-1] and "Traceback" not in ran.err


def test_gravity_shows_the_paper_beside(capsys: Capture) -> None:
    ran = run(capsys, "evaluate", "gravity", "--cases", 3)
    assert ran.code == 0
    assert [line.split()[0] for line in ran.lines[4:6]] == ["9.80665", "9.81676"]
    assert "0.6015" in ran.lines[4] and "0.0090" in ran.lines[5]
    assert [line.split()[0] for line in ran.lines[9:]] == ["9.80665", "9.81676"]
    assert "0.2015" in ran.lines[9] and "0.1276" in ran.lines[10]


def test_gravity_of_a_place(capsys: Capture) -> None:
    words = ("evaluate", "gravity", "--cases", 2, "--latitude", 78, "--altitude", 300, "--json")
    found = json.loads(run(capsys, *words).out)
    place = json.loads(run(capsys, "gravity", "--latitude", 78, "--altitude", 300, "--json").out)
    assert found["local_m_s2"] == found["fits"][1]["assumed_m_s2"] == place["local_m_s2"]
    assert found["published"] == {"default": 0.6015, "local": 0.009}
    assert found["gyroscope"]["published"] == {"default": 0.2015, "local": 0.1276}
    assert [one["fitted"] for one in found["gyroscope"]["fits"]] == [2, 2]
    assert "0.6015" not in run(capsys, *words[:-1]).out, "the paper's figures are of another place"


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--local-gravity", "9.81", "--latitude", "50"), "give one of them"),
        (("--altitude", "50"), "--altitude needs --latitude"),
        (("--points", "20"), "multiple of 9"),
        (("--optimizer", "all"), "one optimizer"),
    ],
)
def test_wrong_words_about_gravity(capsys: Capture, words: tuple[str, ...], part: str) -> None:
    ran = run(capsys, "evaluate", "gravity", "--cases", "1", *words)
    assert ran.code == 2
    assert_one_line(ran, part)

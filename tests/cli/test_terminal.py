"""What reaches the terminal: no control character of a file or of the command line."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import h5py
import pytest

from tests.cli.run import Ran, run
from tests.device_recordings import edit
from tests.recordings import good_raw

Capture = pytest.CaptureFixture[str]
CLI = Path(__file__).resolve().parent.parent.parent / "accelcal_cli" / "cli"
WRITERS = ("click.echo", "click.secho", "print", "sys.stdout.write", "sys.stderr.write")
HOSTILE = "\x1b[31mred\x07\x7f\x9b\u202e"


def assert_harmless(ran: Ran) -> None:
    odd = {char for char in ran.out + ran.err if not char.isprintable()} - {"\n", "\t"}
    assert not odd, ran


def test_text_goes_out_by_one_way_only() -> None:
    """`exit_codes.show` and `say`; bars write what tqdm makes of a name that was made printable."""
    ways = []
    for path in CLI.glob("*.py"):
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        ways += [path.name for call in calls if ast.unparse(call.func) in WRITERS]
    assert set(ways) == {"exit_codes.py"}


def test_a_device_that_calls_itself_by_an_escape_sequence(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        data = file.create_dataset("accelerometer", data=[[0, 0, 256]] * 500)
        data.attrs.update(sample_rate=25.0, lsb_per_g=256.0)
        file.attrs.update(serial_number=HOSTILE, model="a\nb")
    ran = run(capsys, "inspect", path, "--rate", 25, "--lsb-per-g", 256)
    assert ran.code == 0, ran
    assert r"\x1b[31mred\x07" in ran.out
    assert_harmless(ran)
    found = json.loads(run(capsys, "inspect", path, "--rate", 25, "--lsb-per-g", 256, "--json").out)
    assert found["recording"]["device"]["serial"] == HOSTILE


def test_an_unknown_key_of_a_layout(tmp_path: Path, capsys: Capture) -> None:
    path = good_raw(tmp_path)
    layout = tmp_path / "good.layout.toml"
    layout.write_text('"\\u001b[31mred\\u0007" = 1\n' + layout.read_text())
    ran = run(capsys, "calibrate", path)
    assert ran.code == 2
    assert r"\x1b[31mred\x07" in ran.err
    assert_harmless(ran)


@pytest.mark.parametrize(
    "words", [(f"--{HOSTILE}",), ("--format", HOSTILE), ("--timezone", HOSTILE), ("-o", HOSTILE)]
)
def test_words_of_the_command_line(tmp_path: Path, capsys: Capture, words: tuple[str, ...]) -> None:
    assert_harmless(run(capsys, "calibrate", tmp_path / HOSTILE, *words))
    assert_harmless(run(capsys, HOSTILE))


def test_a_message_in_a_report_that_is_up_to_date(tmp_path: Path, capsys: Capture) -> None:
    path = good_raw(tmp_path)
    assert run(capsys, "calibrate", path, "--report-only").code == 0
    edit(tmp_path / "good.calibration.json", lambda held: held.update(message=HOSTILE))
    ran = run(capsys, "calibrate", path, "--report-only", "-v")
    assert "up to date" in ran.err
    assert_harmless(ran)

"""What a run imports: no more than the one format and the outputs that it is about."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

from accelcal_cli.formats import all_formats
from tests.formats import make_csv, make_flash
from tests.recordings import LSB_PER_G, RATE_HZ, directions, still_counts

FORMATS = "accelcal_cli.formats."
TABLES = f"{FORMATS}tables."
SHARED = {"_bytes", "_frames", "_gravity", "_pages", "_problems", "_rows", "_stamps"}
SOURCES = {
    "csv": {"text", "siblings"},
    "parquet": {"arrow"},
    "feather": {"arrow"},
    "hdf5": {"hdf5", "opal"},
    "opal": {"hdf5", "opal"},
    "npz": {"arrays", "npz"},
    "mat": {"arrays", "mat"},
}
"""What reads each kind of tables alone; the other files of their folder are for all kinds."""

FOLDER = dict.fromkeys(SOURCES, "tables")
"""The folder of a format, if it is not called like the format."""

READERS = {item.name: item.reader.partition(":")[0] for item in all_formats()}

ALSO = {"npz": {"gt3x"}}
"""Any zip file may be one of ActiGraph's: only its directory tells."""


PRINT = "print('\\n' + json.dumps(sorted(sys.modules)), flush=True)"


def lists(code: str, *arguments: str) -> list[frozenset[str]]:
    """All lists of modules that code prints in a process of its own."""
    command = [sys.executable, "-c", f"import json, os, sys\n{code}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [frozenset(json.loads(line)) for line in done.stdout.splitlines() if line.startswith("[")]


@cache
def imported(code: str) -> frozenset[str]:
    """All modules that are there after running code in a process of its own."""
    (found,) = lists(f"{code}\n{PRINT}")
    return found


LISTING = "from accelcal_cli.formats import all_formats; all_formats()"
EACH = f"""{LISTING}
import accelcal_cli.cli.calibrate, accelcal_cli.pipeline.calibrate, h5py, pandas, pyarrow.csv, pyarrow.parquet
for words in json.loads(sys.argv[1]):
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
        continue
    from accelcal_cli.cli.main import cli
    assert cli.main(words, "accelcal", standalone_mode=False) == 4
    {PRINT}
    os._exit(0)
"""
"""Each refusal in a child of a process that has imported what formats share, and has opened none of ours."""


@pytest.fixture(scope="module")
def of_each_format(tmp_path_factory: pytest.TempPathFactory) -> dict[str, frozenset[str]]:
    """Modules that calibrating a recording of each format imports."""
    words = {}
    for name in (item.name for item in all_formats()):
        folder = tmp_path_factory.mktemp(name)
        maker = importlib.import_module(f"tests.formats.make_{name}")
        made = maker.make(folder, still_counts(directions(2)), RATE_HZ, LSB_PER_G)
        options = ("--report-only", "--no-temperature", "--strict", "-q", "-d", str(folder / "out"))
        sensor = () if made.options.sensor is None else ("--sensor", made.options.sensor)
        words[name] = ["calibrate", str(made.path), *options, *sensor]
    found = lists(EACH, json.dumps(list(words.values())))
    return dict(zip(words, found, strict=True))


def folders(modules: frozenset[str]) -> set[str]:
    """The folders and shared files of `formats` that modules lie in."""
    return {name.removeprefix(FORMATS).split(".")[0] for name in modules if name.startswith(FORMATS)}


def test_the_modules_that_formats_share_or_have_alone_exist() -> None:
    names = {FORMATS + name for name in SHARED} | {TABLES + name for name in set().union(*SOURCES.values())}
    assert [name for name in sorted(names) if find_spec(name) is None] == []


def test_listing_the_formats_imports_nothing_that_reads() -> None:
    found = imported(LISTING)
    assert {FORMATS + FOLDER.get(item.name, item.name) for item in all_formats()} <= found
    assert not {name for name in found if name.startswith(FORMATS) and name.endswith((".reader", ".writer"))}
    assert not {*READERS.values()} & found
    assert not found & {"zipfile", "tomllib", "csv", "pyarrow", *(FORMATS + name for name in SHARED)}


@pytest.mark.parametrize("name", [item.name for item in all_formats()])
def test_calibrating_imports_this_format_alone(of_each_format: dict[str, frozenset[str]], name: str) -> None:
    found, folder = of_each_format[name] - imported(LISTING), FOLDER.get(name, name)
    assert READERS[name] in found
    assert folders(found) - SHARED <= {folder} | ALSO.get(name, set())
    tables = {one.removeprefix(TABLES).split(".")[0] for one in found if one.startswith(TABLES)}
    assert tables & set().union(*SOURCES.values()) <= SOURCES.get(name, set())


def commands(*lines: tuple[str, ...]) -> str:
    """Code that runs commands, and prints the modules that are there after each."""
    runs = [
        f"assert cli.main({list(words)!r}, 'accelcal', standalone_mode=False) == 0\n{PRINT}"
        for words in lines
    ]
    return "\n".join(["from accelcal_cli.cli.main import cli", *runs])


def test_no_help_waits_for_what_only_running_needs() -> None:
    loaded = "{name for name in sys.modules if name in ('pyarrow', 'pandas', 'h5py', 'jinja2')}"
    code = f"""
import accelcal_cli.cli.calibrate, accelcal_cli.pipeline.calibrate  # which most commands need
from accelcal_cli.cli.main import cli
def show(command, *words):
    for name in getattr(command, "list_commands", lambda _: [])(None):
        if child := os.fork():
            assert os.waitpid(child, 0)[1] == 0
            continue
        show(command.get_command(None, name), *words, name)
        os._exit(0)
    assert cli.main([*words, "--help"], "accelcal", standalone_mode=False) == 0
    print("\\n" + json.dumps([" ".join(words), *sorted({loaded})]), flush=True)
show(cli)
"""
    found = lists(code)
    assert {frozenset({"fit"}), frozenset({"evaluate segments"})} <= set(found)
    assert [names for names in found if len(names) > 1] == []


def calibrating(path: Path, *words: str) -> tuple[str, ...]:
    return ("calibrate", str(path), "-d", str(path.parent / "out"), "-q", "--force", *words)


def test_a_report_alone_is_written_without_pyarrow(tmp_path: Path) -> None:
    made = make_flash.make(tmp_path, still_counts(directions(12)), RATE_HZ, LSB_PER_G)
    report, both = lists(commands(calibrating(made.path, "--report-only"), calibrating(made.path)))
    assert "pyarrow" not in report and "pyarrow" in both
    assert not {"pandas", "numpy.ma"} & both


def test_a_text_table_is_calibrated_without_arrows_computing(tmp_path: Path) -> None:
    made = make_csv.make(tmp_path, still_counts(directions(12)), RATE_HZ, LSB_PER_G)
    (found,) = lists(commands(calibrating(made.path)))
    assert "pyarrow.csv" in found
    assert "pyarrow.compute" not in found


def test_only_a_page_needs_what_makes_pages(tmp_path: Path) -> None:
    made = make_flash.make(tmp_path, still_counts(directions(12)), RATE_HZ, LSB_PER_G)
    without, with_page = lists(
        commands(calibrating(made.path, "--report-only"), calibrating(made.path, "--report-only", "--html"))
    )
    assert not {"jinja2", "markupsafe", "accelcal_cli.pages"} & without
    assert {"jinja2", "accelcal_cli.pages.recording"} <= with_page


@pytest.mark.nightly
def test_templates_are_loaded_for_pages_alone(of_each_format: dict[str, frozenset[str]]) -> None:
    study = imported("import accelcal_cli.cli.study, accelcal_cli.cli.report")
    for found in (study, of_each_format["flash"]):
        assert not found & {"jinja2", "markupsafe", "accelcal_cli.pages.rendering"}
    assert "accelcal_cli.pages.rendering" in imported("import accelcal_cli.pages.write")


def test_what_workers_are_forked_from_has_all_that_a_recording_needs(tmp_path: Path) -> None:
    made = make_flash.make(tmp_path, still_counts(directions(12)), RATE_HZ, LSB_PER_G)
    ready = "import accelcal_cli.studies.preload, accelcal_cli.cli.calibrate, accelcal_cli.cli.main"
    before, after = lists(f"{ready}\n{PRINT}\n{commands(calibrating(made.path))}")
    assert after - before - {"difflib"} == set()  # click looks for the nearest option to `-d`

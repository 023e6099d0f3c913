"""The documentation site: each page is in its contents once, and there are few enough to find one."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"


def contents() -> list[str]:
    """Return the pages in the contents of the site."""
    trees = re.findall(r"```\{toctree\}\n(.*?)```", (DOCS / "index.md").read_text("utf-8"), re.DOTALL)
    return [line for tree in trees for line in tree.splitlines() if line and not line.startswith(":")]


def reference() -> Any:
    """Load the module that makes the reference pages."""
    spec = importlib.util.spec_from_file_location("docs_reference", ROOT / "tools/docs_reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_page_is_in_the_contents_once() -> None:
    written = {page.stem for page in DOCS.glob("*.md")} - {"index"}
    listed = [page for page in contents() if not page.startswith("reference/")]
    assert sorted(listed) == sorted(written)
    assert len(contents()) <= 40


def test_each_reference_page_in_the_contents_is_made(tmp_path: Path) -> None:
    module = reference()
    module.write(tmp_path)
    made = {page.stem for page in tmp_path.iterdir()}
    assert {page.removeprefix("reference/") for page in contents() if page.startswith("reference/")} == made


def test_the_reference_of_commands_has_every_option_and_example() -> None:
    text = "\n".join(reference().commands())
    assert "## accelcal calibrate" in text and "## accelcal evaluate segments" in text
    assert "| `--unit [g|mg|m/s2|counts]` |" in text.replace("\\|", "|")
    assert "\naccelcal calibrate recording.cwa\n" in text


def test_the_reference_of_files_has_every_key_and_column() -> None:
    text = "\n".join(reference().files())
    assert "`calibration_error_mg.ci95`" in text and "`rows.worn`" in text
    assert "`file_health.problems[].code`" in text
    assert "| `device_serial` | serial number of the device |" in text

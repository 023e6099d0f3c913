"""The documentation site: each page is in its contents once, and there are few enough to find one."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

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
    assert "| `--unit g|mg|m/s2|counts` |" in text.replace("\\|", "|")
    assert "\naccelcal calibrate recording.cwa\n" in text


def test_the_reference_of_files_has_every_key_and_column() -> None:
    text = "\n".join(reference().files())
    assert "`calibration_error_mg.ci95`" in text and "`rows.worn`" in text
    assert "`file_health.problems[].code`" in text
    assert "| `device_serial` | serial number of the device |" in text


READERS = {
    "technician: it was refused, what now?": (["docs/refused.md"], "## The most frequent reasons"),
    "technician: a short recording": (["docs/refused.md#which-way-helps-a-short-recording"], "--borrow"),
    "data manager: every night": (["docs/study.md", "#every-night"], "cron"),
    "data manager: options of some files": (
        ["docs/study.md", "#options-for-some-of-the-recordings"],
        "study.toml",
    ),
    "analyst: functions": (["docs/python.md"], "accelcal.calibrate"),
    "analyst: load the samples": (["docs/cookbook.md"], "read_parquet"),
    "R user: GGIR": (["docs/exports.md"], "backup.cal.coef"),
    "R user: run GGIR on calibrated data": (["docs/r.md"], "GGIR"),
    "reviewer: the model": (["docs/how-it-works.md"], "a = K (v + q"),
    "reviewer: the prior": (["docs/prior.md"], "Student"),
    "reviewer: validation": (["docs/evaluation.md#real-recordings"], "mg"),
    "reviewer: other tools": (["docs/compared.md"], "GGIR"),
    "contributor: build and layers": (["CONTRIBUTING.md", "docs/architecture.md"], "cli"),
    "anyone: what an upgrade changes": (["CHANGELOG.md", "docs/study.md#upgrading"], "made again"),
}
"""Links from README to the answer of each reader, and words of the answer."""


def links(page: Path) -> set[str]:
    """Return the targets of links in a page, from the root of the project; `#name` within the page."""
    found = set()
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        path, _, anchor = target.partition("#")
        if "://" in target:
            continue
        whole = (page.parent / path).resolve().relative_to(ROOT).as_posix() if path else ""
        found |= {whole, whole + "#" + anchor} if anchor else {whole}
    return found


def section(page: Path, anchor: str) -> str:
    """Return a section of a page with its heading; the whole page without an anchor."""
    text = page.read_text("utf-8")
    if not anchor:
        return text
    for part in re.split(r"(?m)^(?=#+ )", text):
        name = re.sub(r"[^\w\- ]", "", part.partition("\n")[0].lstrip("# ").lower()).replace(" ", "-")
        if name == anchor:
            return part
    raise LookupError(anchor)


@pytest.mark.parametrize("reader", READERS)
def test_each_reader_is_two_clicks_from_the_answer(reader: str) -> None:
    clicks, words = READERS[reader]
    assert len(clicks) <= 2
    page, anchor = ROOT / "README.md", ""
    for click in clicks:
        path, _, anchor = click.partition("#")
        assert not path or click in links(page), (page.name, click)
        page = ROOT / path if path else page
    assert words in section(page, anchor)


def test_each_picture_is_shown_with_a_text_in_its_place() -> None:
    pages = [ROOT / "README.md", *DOCS.glob("*.md")]
    shown = [
        found for page in pages for found in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", page.read_text("utf-8"))
    ]
    assert [target for text, target in shown if len(text.split()) < 5] == []
    assert {Path(target).name for _, target in shown} == {
        one.name for one in DOCS.iterdir() if one.suffix in {".png", ".svg"}
    }

"""The rules of words: each finds its bad example and passes the good one, and the project breaks none."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.lint_words import ALLOWED, DEFAULT, FIELD, LITERARY, ROOT, RULES, Text, everything, findings

EXAMPLES = [
    *(("docstring", f"It was {word} there.", f"It was {plain} there.") for word, plain in LITERARY.items()),
    ("doc", "The posture is new.", "The orientation is new."),
    ("page", "Its error over the whole sphere.", "Its error over all orientations."),
    ("help", "Writes STEM.html.", "Writes NAME.html."),
    ("doc", "They are held against others.", "They are compared with others."),
    ("help", "Also write a page for people.", "Also write an HTML page."),
    ("doc", "It is read. Of a folder the first is.", "It is read. In a folder the first is. Of course."),
    ("help", "Of files without a zone.", "Time zone, if the file states none."),
    ("docstring", "What the user states.", "Statements of the user."),
    ("docstring", "Whether it holds.", "True if it holds."),
    ("help", "Take over after so many minutes.", "Take over after MINUTES."),
    ("doc", "It waits for so long.", "It waits for 10 s, as long as so much is free as it needs."),
    ("doc", "So few rows do.", "Eleven rows do."),
    ("docstring", "The pass was told to end.", "The pass ends."),
    ("help", "It is only told.", "It is only reported."),
    ("docstring", "Columns that tell of sensors.", "Columns that tell sensors apart."),
    ("doc", "Nothing tells how long it was.", "That tells one device from another."),
    ("doc", "The marker stands at the end.", "The marker is at the end, x stands for a number, a stand-in."),
    ("help", "The file is no recording.", "The file is not a recording. There is no other."),
    ("docstring", "None if the text is none.", "None if it is None."),
    ("doc", "It shows it; what is left is noise.", "The rest is noise. What is a recording?"),
    ("page", "What was found", "Findings"),
    ("doc", "It is worth a lot of what it costs.", "It is worth the cost."),
    ("doc", "One (of the first kind) is read (but not used) here.", "One (of the first kind) is (0, 1, -2)."),
    ("page", "One (a b c). Two (d e f) of (g h i).", "One (a b c). Two (d e f)."),
    ("page", "One; two; three.", "One; two. Three."),
    ("cell", "word " * 26, "word " * 25),
    ("cell", "It was put right.", "It was corrected."),
    ("help", "it is damaged; it ends early; copy it again", "it ends early; copy it again"),
]
"""Kinds of text with a bad and a good example, for each rule one at least."""


def found(kind: str, words: str) -> list[str]:
    return [*findings(iter([Text("here", kind, words)]))]


@pytest.mark.parametrize(("kind", "bad", "good"), EXAMPLES)
def test_a_rule_finds_the_bad_example_and_passes_the_good_one(kind: str, bad: str, good: str) -> None:
    assert found(kind, bad)
    assert found(kind, good) == []


def test_every_rule_has_an_example() -> None:
    for rule in RULES:
        assert any(kind in rule.kinds and rule.pattern.search(bad) for kind, bad, _ in EXAMPLES), rule.name
    assert len(LITERARY) + len(FIELD) < len(RULES)


def test_what_is_allowed_is_argued_and_still_there() -> None:
    texts = [one.text for one in everything(DEFAULT)]
    assert len(ALLOWED) <= 10
    for part, reason in ALLOWED.items():
        assert len(reason.split()) >= 3 and any(part in text for text in texts), part


def test_code_links_and_released_entries_are_not_read(tmp_path: Path) -> None:
    text = "Good.\n\n```\nmended\n```\n\n`mended` [x](mended.md)\n\n| a | mended |\n|---|---|\n"
    log = "## Unreleased\n\n- anew\n\n## 1.0\n\n- mended\n"
    made = {"page.md": text, "CHANGELOG.md": log, "page.html": "<p class='mended'>{{ mended }} a thus</p>"}
    lines = []
    for name, words in made.items():
        path = tmp_path / name
        path.write_text(words, encoding="utf-8")
        lines += [line.split(": ")[:2] for line in findings(everything([path]))]
    assert [(Path(place).name, rule) for place, rule in lines] == [
        ("page.md:9", "write `fixed` for `mended`"),
        ("CHANGELOG.md:3", "write `again` for `anew`"),
        ("page.html:1", "write `so` for `thus`"),
    ]


def test_the_project_breaks_no_rule() -> None:
    assert ROOT / "docs" in DEFAULT and ROOT / "accelcal_cli" in DEFAULT
    assert [*findings(everything(DEFAULT))] == []

"""The glossary: at most forty words, each with one meaning, in the order of the alphabet."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_the_glossary_has_at_most_forty_words() -> None:
    lines = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if line.startswith("| ") and "meaning |" not in line]
    words = [row.split("|")[1].strip() for row in rows]
    assert 20 < len(words) <= 40
    assert len(set(words)) == len(words)
    assert words == sorted(words, key=str.lower)

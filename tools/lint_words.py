"""Check the words of the project by rules that are patterns: help, messages, documents and docstrings.

`python tools/lint_words.py [PATH...]` prints each finding as `place: rule: text`, and exits with 1 if there
are any. The rules are those of plain English; docs/glossary.md has the vocabulary.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True, slots=True)
class Rule:
    """A pattern of words to avoid.

    Attributes:
        name: what is wrong, and what to write instead.
        kinds: kinds of text that it holds for: `doc`, `help`, `docstring`.
    """

    name: str
    pattern: re.Pattern[str]
    kinds: tuple[str, ...] = ("doc", "help", "docstring")


def _rule(name: str, pattern: str, *kinds: str) -> Rule:
    return Rule(name, re.compile(pattern, re.IGNORECASE), kinds or ("doc", "help", "docstring"))


LITERARY = {
    "mended": "fixed",
    "anew": "again",
    "meanwhile": "during the recording",
    "put right": "correct",
    "puts right": "corrects",
    "taken for": "treated as",
    "hand on": "export",
    "hands on": "exports",
    "handed on": "exported",
    "but for": "except",
    "wholly": "completely",
    "thus": "so",
    "beside it": "next to it",
    "goes on": "continues",
    "go on": "continue",
}
"""Literary words, and what to write instead."""

RULES = (
    *(_rule(f"write `{plain}` for `{word}`", rf"\b{word}\b") for word, plain in LITERARY.items()),
    _rule("begin with the thing, not with `Of`", r"(?:^|[.!?:] )Of (?!course)[a-z]"),
    _rule(
        "write N or the unit, not `so many` or `so long`", r"\bso (?:many|much|long|far|near)\b(?! as| that)"
    ),
    _rule("a thing reports or shows; it does not tell", r"\b(?:is|are) told\b|\bonly told\b|\btells of\b"),
    _rule(
        "write `is not a`, not `is no`",
        r"\b(?:is|are|was|were) (?:no|none)\b (?!longer|more|less|fewer|lower|worse|better|such)",
    ),
    _rule(
        "name the thing, not `what is` or `what the`",
        r"(?:^|[.;:,] )what (?:is|was|are|were|the|a|it|they)\b[^?]*$|\bof what\b",
    ),
    _rule("one semicolon at most in a paragraph", r";[^;]*;", "doc", "help"),
)


@dataclass(frozen=True, slots=True)
class Text:
    """A piece of text and where it stands."""

    place: str
    kind: str
    text: str


def documents(paths: list[Path]) -> Iterator[Text]:
    """Yield the paragraphs and cells of Markdown files, code left out."""
    for path in paths:
        fenced, paragraph, start = False, [], 1
        for number, line in enumerate([*path.read_text("utf-8").splitlines(), ""], 1):
            if line.startswith("```"):
                fenced = not fenced
            if fenced or line.startswith(("```", "    ", "#")):
                continue
            if line.startswith("|"):
                for cell in line.strip("|").split("|"):
                    yield Text(f"{path.relative_to(ROOT)}:{number}", "doc", _plain(cell))
                continue
            if line.strip() and not re.match(r"\s*(?:[-*]|\d+\.) ", line):
                start = start if paragraph else number
                paragraph.append(line.strip())
                continue
            if paragraph:
                yield Text(f"{path.relative_to(ROOT)}:{start}", "doc", _plain(" ".join(paragraph)))
            paragraph, start = ([line.strip()] if line.strip() else []), number


def _plain(text: str) -> str:
    """Return Markdown text without code and the targets of links."""
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return re.sub(r"`[^`]*`", "`x`", text).strip()


def python_texts(paths: list[Path]) -> Iterator[Text]:
    """Yield docstrings, and the strings of the package, which are help and messages."""
    for path in paths:
        tree = ast.parse(path.read_text("utf-8"))
        docs = {id(node) for node in ast.walk(tree) for node in _docstrings(node)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                kind = "docstring" if id(node) in docs else "help"
                text = " ".join(node.value.split())
                if " " in text:
                    yield Text(
                        f"{path.relative_to(ROOT)}:{node.lineno}", kind, re.sub(r"`[^`]*`", "`x`", text)
                    )


def _docstrings(node: ast.AST) -> Iterator[ast.Constant]:
    """Yield the docstrings in a node's body: its own, and those below its assignments."""
    body = getattr(node, "body", None)
    for statement in body if isinstance(body, list) else ():
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            yield statement.value


def findings(texts: Iterator[Text]) -> Iterator[str]:
    """Yield the rules that texts break."""
    for one in texts:
        for rule in RULES:
            found = rule.pattern.search(one.text) if one.kind in rule.kinds else None
            if found is not None:
                start = max(0, found.start() - 30)
                yield f"{one.place}: {rule.name}: ...{one.text[start : found.end() + 40]}"


def main(names: list[str]) -> int:
    """Print what is found and return the exit code."""
    chosen = [ROOT / name for name in names] or [ROOT / "accelcal_cli", ROOT / "docs", *ROOT.glob("*.md")]
    files = [file for path in chosen for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    markdown = [file for file in files if file.suffix == ".md"]
    python = [file for file in files if file.suffix == ".py"]
    found = [*findings(documents(markdown)), *findings(python_texts(python))]
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Check the words of the project by rules that are patterns: documents, help, messages, pages and docstrings.

`python tools/lint_words.py [PATH...]` prints each finding as `place: rule: text`, and exits with 1 if there
are any. The rules are those of plain English; docs/glossary.md has the vocabulary.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


ALL = ("doc", "help", "page", "docstring")
FOR_USERS = ("doc", "help", "page")
"""Kinds of text that users read."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A pattern of words to avoid.

    Attributes:
        name: the fault, and the words to write instead.
        kinds: kinds of text that the rule holds for: `doc` (and cells of its tables), `cell`, `help` (and
            messages), `page`, `docstring`.
    """

    name: str
    pattern: re.Pattern[str]
    kinds: tuple[str, ...] = ALL


def _rule(name: str, pattern: str, kinds: tuple[str, ...] = ALL, *, case: bool = False) -> Rule:
    return Rule(name, re.compile(pattern, 0 if case else re.IGNORECASE), kinds)


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
    "beside": "next to",
    "goes on": "continues",
    "go on": "continue",
}
"""Literary words, and the words to write instead."""

FIELD = {
    r"postures?": "orientation",
    r"(?:over )?the whole sphere": "over all orientations",
    r"STEM": "NAME",
    r"held against": "compared with",
    r"(?:page|pages|words) for people": "HTML page",
}
"""Words that mean something else to people of the field, or nothing, and those to write instead."""

REMARK = r"\((?![-\d., ]*\))[^()=+−]* [^()=+−]* [^()=+−]*\)"
"""Three words or more in parentheses, which are neither a formula nor a vector."""
LONGEST_CELL = 25
LONGER = rf"^(?:\S+\s+){{{LONGEST_CELL}}}\S"
"""Too many words for a cell of a table."""
BE = r"\b(?:is|are|was|were)"
RULES = (
    *(_rule(f"write `{plain}` for `{word}`", rf"\b{word}\b") for word, plain in LITERARY.items()),
    *(_rule(f"write `{plain}`", rf"\b{word}\b", FOR_USERS) for word, plain in FIELD.items()),
    _rule("begin with the thing, not with `Of`", r"(?:^|[.!?] )Of (?!course)[a-z`]", case=True),
    _rule(
        "a sentence has a subject and a verb",
        r"^(?:So|Those|Whether|Of|Between|That|Such) [a-z]|^What (?!to )[^?]*$",
        ("docstring",),
        case=True,
    ),
    _rule(
        "write N or the unit", r"\b(?:for|of|at most|by|than|let|only) so (?:many|much|long|far|few)\b(?! as)"
    ),
    _rule("write N or the unit", r"\bso (?:many|few) (?!as|that|of)"),
    _rule("a thing reports or shows; it does not tell", rf"{BE} told\b|\bonly told\b|\btells? of\b"),
    _rule(
        "a thing reports or shows; it does not tell",
        r"\b(?:tells|told)\b(?! (?:\w+ ){0,4}(?:apart|from)\b)",
        FOR_USERS,
    ),
    _rule("write `is` for `stands`", r"\bstands?\b(?!-| (?:in )?for\b)", FOR_USERS),
    _rule(
        "write `is not a`, not `is no`",
        rf"(?<![Tt]here ){BE} (?:no|none)\b(?! (?:longer|more|less|fewer|lower|higher|worse|better|such))",
        case=True,
    ),
    _rule(
        "name the thing, not `what is`",
        r"(?:^|[.;:,] )what (?:is|was|are|were|the|a|it|they)\b[^?]*$|\bof what\b",
        FOR_USERS,
    ),
    _rule(
        "one remark in parentheses at most in a sentence",
        rf"{REMARK}(?:(?![.!?:] ).)*?{REMARK}",
        ("doc", "page"),
    ),
    _rule("one semicolon at most in a paragraph", r";[^;]*;", ("doc", "page")),
    _rule(f"{LONGEST_CELL} words at most in a cell: make a list or a section of it", LONGER, ("cell",)),
    _rule("no semicolon chain in a message", r"; [^;]*; ", ("help",)),
)

ALLOWED = {
    "previous posture": "value of `misfits` in reports of all versions",
    "folds of whole postures": "value of `holdout.method` in reports of all versions",
}
"""Parts of texts that a rule would find and that are right, with the reason."""

MESSAGES = ("reasons.md",)
"""Pages whose cells are whole messages, however long these are."""


@dataclass(frozen=True, slots=True)
class Text:
    """A piece of text and its place."""

    place: str
    kind: str
    text: str


def documents(paths: list[Path]) -> Iterator[Text]:
    """Yield the paragraphs and cells of Markdown files without code, and without releases that are out."""
    for path in paths:
        fenced, paragraph, start, released = False, [], 1, 0
        for number, line in enumerate([*path.read_text("utf-8").splitlines(), ""], 1):
            released += path.name == "CHANGELOG.md" and line.startswith("## ")
            if released > 1:
                break
            if line.startswith("```"):
                fenced = not fenced
            if fenced or line.startswith(("```", "    ", "#")):
                continue
            if line.startswith("|"):
                for cell in re.split(r"(?<!\\)\|", line.strip("|")):
                    kind = "doc" if path.name in MESSAGES else "cell"
                    yield Text(f"{_shown(path)}:{number}", kind, _plain(cell))
                continue
            if line.strip() and not re.match(r"\s*(?:[-*]|\d+\.) ", line):
                start = start if paragraph else number
                paragraph.append(line.strip())
                continue
            if paragraph:
                yield Text(f"{_shown(path)}:{start}", "doc", _plain(" ".join(paragraph)))
            paragraph, start = ([line.strip()] if line.strip() else []), number


def _shown(path: Path) -> Path:
    """Return a path below the project, or the whole one of another file."""
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


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
                    yield Text(f"{_shown(path)}:{node.lineno}", kind, re.sub(r"`[^`]*`", "`x`", text))


def pages(paths: list[Path]) -> Iterator[Text]:
    """Yield the texts between the tags of templates, without what the template language does."""
    for path in paths:
        text = re.sub(
            r"{#.*?#}|{%.*?%}|<(?:script|style)\b.*?</(?:script|style)>",
            _blank,
            path.read_text("utf-8"),
            flags=re.S,
        )
        text = re.sub(r"{{.*?}}", lambda found: "x" + _blank(found), text, flags=re.S)
        for found in re.finditer(
            r"[^<>]+(?=<)", re.sub(r"<[^<>]*>", lambda tag: "<" + _blank(tag)[1:-1] + ">", text)
        ):
            words = " ".join(found[0].split())
            if " " in words:
                yield Text(f"{_shown(path)}:{text.count(chr(10), 0, found.start()) + 1}", "page", words)


def _blank(found: re.Match[str]) -> str:
    """Return the line ends of a match, and blanks for the rest."""
    return re.sub(r"[^\n]", " ", found[0])


def _docstrings(node: ast.AST) -> Iterator[ast.Constant]:
    """Yield the docstrings in a node's body: its own, and those below its assignments."""
    body = getattr(node, "body", None)
    for statement in body if isinstance(body, list) else ():
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            yield statement.value


def findings(texts: Iterator[Text]) -> Iterator[str]:
    """Yield the rules that texts break."""
    for one in texts:
        text = reduce(lambda words, part: words.replace(part, "x"), ALLOWED, one.text)
        for rule in RULES:
            of_kind = one.kind in rule.kinds or (one.kind == "cell" and "doc" in rule.kinds)
            found = rule.pattern.search(text) if of_kind else None
            if found is not None:
                yield f"{one.place}: {rule.name}: ...{text[max(0, found.start() - 30) : found.end() + 40]}"


def everything(paths: list[Path]) -> Iterator[Text]:
    """Yield the texts of files and folders."""
    files = [file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path])]
    files = [file for file in files if MADE not in file.parents]
    yield from documents([file for file in files if file.suffix == ".md"])
    yield from python_texts([file for file in files if file.suffix == ".py"])
    yield from pages([file for file in files if file.suffix == ".html"])


MADE = ROOT / "docs/reference"
"""Pages of the site that are made from the program, whose words are checked there."""

DEFAULT = [
    ROOT / "accelcal",
    ROOT / "accelcal_cli",
    ROOT / "docs",
    *sorted(ROOT.glob("*.md")),
]
"""All that is checked."""


def main(names: list[str]) -> int:
    """Print the findings and return the exit code."""
    found = [*findings(everything([Path(name).resolve() for name in names] or DEFAULT))]
    print("\n".join(found) if found else "No finding.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Each format with absurd sizes and texts in its header: little memory, no other file, no control character.

The small file of `make_NAME.py` is changed in place: a number after the other to the largest there is, a text
after the other to one that a terminal, a page or a spreadsheet would obey.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.formats import Format
from accelcal_cli.formats import all_formats
from tests.cli.run import nightly
from tests.faults.shim import Runner, Struck

HEAD_BYTES, TAIL_BYTES = 2048, 512
LARGEST = (b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\xff\xff\xff\xff\xff\xff\xff\x7f", b"\x7f\xff\xff\xff")
DIGITS = re.compile(rb"[0-9]{1,12}")
TEXT = re.compile(rb"[A-Za-z][A-Za-z0-9 ]{3,}")
HOSTILE = b"\x1b[7m\x07\r\n\x9b2J=1+1<b>\xe2\x80\xae</script>\x08\x7f"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")
PLACES = (*filter(None, sys.path), sys.base_prefix, "/proc/", "/sys/", "/dev/", "/etc/", "/usr/", "/lib")
"""Below them lies what Python and its libraries open for themselves."""


def sizes(data: bytes) -> Iterator[bytes]:
    """A file with one number after the other as large as can be: binary ones, and those of digits."""
    head = [(found.start(), found.end()) for found in DIGITS.finditer(data[:HEAD_BYTES])]
    for start, end in head:
        yield data[:start] + b"9" * (end - start) + data[end:]
    places = [*range(0, min(HEAD_BYTES, len(data)), 2), *range(max(0, len(data) - TAIL_BYTES), len(data), 2)]
    for number, place in enumerate(places):
        large = LARGEST[number % len(LARGEST)]
        yield (data[:place] + large + data[place + len(large) :])[: len(data)]


def texts(data: bytes) -> Iterator[bytes]:
    """A file with one text after the other that is obeyed where it is shown as it is."""
    for found in TEXT.finditer(data[:HEAD_BYTES]):
        length = found.end() - found.start()
        for first in range(0, len(HOSTILE), length):
            yield data[: found.start()] + HOSTILE[first:][:length].ljust(length) + data[found.end() :]


def some(mutants: Iterator[bytes], number: int) -> list[bytes]:
    """A number of them, spread over all."""
    found = list(mutants)
    if len(found) <= number:
        return found
    return [found[(2 * index + 1) * len(found) // (2 * number)] for index in range(number)]


def assert_harmless(struck: Struck, here: Path, shim: Path) -> None:
    ran = struck.ran
    assert ran.code in (0, 2, 3, 4), ran
    assert ran.err.count("\n") <= 1, ran
    assert not CONTROL.search(ran.out + ran.err), ran
    own = (str(here), str(shim), *PLACES)
    assert not [path for path in struck.opened if not path.startswith(own)], ran
    for path in (here / "out").iterdir():
        if path.suffix in (".json", ".html"):
            assert not CONTROL.search(path.read_text()), (path.name, ran)
        if path.suffix == ".html":
            assert "<b>" not in path.read_text(), ran


@pytest.mark.parametrize("number", [1, nightly(200)])
@pytest.mark.parametrize("change", [sizes, texts], ids=lambda one: one.__name__)
@pytest.mark.parametrize("item", all_formats(), ids=lambda item: item.name)
def test_a_header_of_claims(runner: Runner, tmp_path: Path, item: Format, change: Any, number: int) -> None:
    for name in ("in", "out", "tmp"):
        (tmp_path / name).mkdir()
    counts = np.random.RandomState(11).randint(-500, 500, (1200, 3)).astype(np.int16)
    made = importlib.import_module(f"tests.formats.make_{item.name}").make(
        tmp_path / "in", counts, 50.0, 256.0
    )
    data = made.path.read_bytes()
    words = ["calibrate", made.path.relative_to(tmp_path).as_posix(), "-d", "out", "-q", "--html", "--force"]
    for mutant in some(change(data), number):
        made.path.write_bytes(mutant)
        try:
            struck = runner.run([*words, *options_of(made.options)], tmp_path, limit_s=60)
            assert_harmless(struck, tmp_path, runner.folder)
        except AssertionError:
            (tmp_path / "failed").write_bytes(mutant)
            raise


def options_of(options: Any) -> list[str]:
    """What the command is told that the file does not say."""
    told: list[str] = []
    for name, word in (
        ("layout", "--layout"),
        ("unit", "--unit"),
        ("lsb_per_g", "--lsb-per-g"),
        ("rate_hz", "--rate"),
    ):
        if (value := getattr(options, name)) is not None:
            told += [word, str(value)]
    return told

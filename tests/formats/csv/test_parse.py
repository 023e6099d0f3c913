"""Blocks of `text/lines.py` as columns: values, line numbers and lost rows, against plain Python."""

from __future__ import annotations

import csv
import gzip
import math
import random
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.formats._stamps import IMPOSSIBLE, NO_TIME
from accelcal_cli.formats.tables.cells import MISSING
from accelcal_cli.formats.tables.header import As, Block, CellTexts, Kind
from accelcal_cli.formats.tables.text.dialect import MOST_JOINED, Dialect, Normaliser
from accelcal_cli.formats.tables.text.lines import LineCutter, LineParser, lone_block
from accelcal_cli.formats.tables.values import NOT_ROWS
from tests.formats.make_csv import START_US, read, stamp, written

WANTED = {0: As.MOMENT, 1: As.NUMBER, 2: As.NUMBER, 3: As.CODES, 4: As.TEXT}
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?inf")
CLOCK = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?)?", re.ASCII)


def dialect(columns: int = 5, delimiter: str = ",", **more: Any) -> Dialect:
    kinds = (Kind.NUMBER,) * columns
    return Dialect(Normaliser(delimiter, **more), kinds, None, None, 1, (), (), 0, 0, False, 0, frozenset())


def parsed(text: str | bytes, layout: Dialect | None = None, wanted: dict[int, As] = WANTED) -> Block:
    data = text if isinstance(text, bytes) else text.encode()
    return LineParser(Path("a.csv"), layout or dialect()).parse(lone_block(data, 1, 0), wanted)


def plain(found: Any) -> list[Any]:
    """The values of a column, None where empty, and texts without blanks that do not matter."""
    if isinstance(found, np.ndarray):
        return [None if value == NO_TIME or math.isnan(value) else value for value in found.tolist()]
    coded = isinstance(found, CellTexts)
    texts = [[*found.texts, None][code] for code in found.codes] if coded else found.to_pylist()
    return [None if text is None else tidy(text) for text in texts]


def rows_of(*parts: Block) -> list[tuple[Any, ...]]:
    """Line and values of every row; the values are None where it is lost."""
    rows = []
    for part in parts:
        columns = [plain(part.values[column]) for column in WANTED]
        for row, (line, *cells) in enumerate(zip(part.line.tolist(), *columns, strict=True)):
            assert row not in part.bad or cells == [None] * 5
            rows.append((line, None if row in part.bad else cells))
    return rows


# A reader in plain Python


def scanned(line: str) -> tuple[int, int]:
    """The place of the quote that a line leaves open, -1 without one, and the number of its cells."""
    begin, quoted, fresh, cells, place = -1, False, True, 1, 0
    while place < len(line):
        letter = line[place]
        if quoted and line[place : place + 2] == '""':
            place += 1
        elif quoted:
            quoted = letter != '"'
        elif letter == '"' and fresh:
            begin, quoted = place, True
        elif letter == ",":
            cells += 1
        fresh = not quoted and letter == ","
        place += 1
    return begin if quoted else -1, cells


def is_row(line: str) -> bool:
    return line.count(",") == 4 or scanned(line) == (-1, 5)


def closed(line: str) -> str:
    while (place := scanned(line)[0]) >= 0:
        line = f"{line[:place]}'{line[place + 1 :]}"
    return line


def last_line(lines: list[str], first: int) -> int:
    """The line in which a cell that is open in the first one ends; the first where it has no such line."""
    for last in range(first + 1, min(first + MOST_JOINED + 1, len(lines))):
        place, cells = scanned(" ".join(lines[first : last + 1]))
        if place < 0:
            return last if cells == 5 and not (is_row(lines[first]) and is_row(lines[last])) else first
        if is_row(lines[last]):
            return first
    return first


def settled(lines: list[str]) -> Iterator[tuple[int, str, str]]:
    """Number, settled text and text as it is of each line, those that belong together joined."""
    first = 0
    while first < len(lines):
        last = last_line(lines, first) if scanned(lines[first])[0] >= 0 else first
        text = " ".join(lines[first : last + 1])
        yield first + 1, text if last > first else closed(text), text
        first = last + 1


def moment(cell: str) -> int:
    """Microseconds of a time; raises ValueError for a text that is none."""
    if not CLOCK.fullmatch(cell):
        raise ValueError
    late = ":60" in cell
    try:
        found = datetime.fromisoformat(cell.replace(":60", ":59")).replace(tzinfo=UTC)
    except ValueError:
        return IMPOSSIBLE
    if not 1678 <= found.year < 2262:
        return IMPOSSIBLE
    return (found + timedelta(seconds=late) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1)


def number(cell: str) -> float:
    if not NUMBER.fullmatch(cell):
        raise ValueError
    return float(cell)


def values(line: str) -> list[Any] | None:
    """The values of a settled line; None if it is not a row."""
    cells = [cell.strip() for cell in next(csv.reader([line]), [])]
    if len(cells) != 5:
        return None
    try:
        made = [
            None if cell in MISSING else make(cell)
            for cell, make in zip(cells, (moment, number, number), strict=False)
        ]
    except ValueError:
        return None
    return [*made, *(None if cell in MISSING else tidy(cell) for cell in cells[3:])]


def tidy(line: str) -> str:
    return re.sub(" ?, ?", ",", re.sub(" +", " ", line)).strip(" ")


def by_hand(lines: list[str]) -> list[tuple[Any, ...]]:
    """Line and values of every row, as `rows_of`."""
    rows = []
    for line, text, raw in settled(lines):
        if text.strip(" "):
            found = values(text)
            rows.append((line, found if found is not None else values(closed(tidy(raw)))))
    return rows


# Blocks of every kind

TIMES = [
    *("2024-03-04T10:41:40.25", "2024-03-04 10:41:41", "2024-03-04 10:41", "2024-03-05"),
    *('"2024-03-04T10:41:40.5"', "", "NaN", " 2024-03-04T10:41:42 ", "2024-03-04  10:41:43"),
    *("2024-02-30T00:00:00", "2024-03-04T10:59:60.5", "2024-03-04T25:00:00", "0001-01-01 00:00:00"),
    *("yesterday", "2024-03", "2024-03-04T10:41:40Z", "10:41:40"),
]
NUMBERS = [
    *("1.5", "-0.25", "0", "7.", ".5", "1e-3", "+4", '"2.5"', "inf", "", "NaN", "-"),
    *(" 2.5", "3 ", ' "3.5"', " NA "),
    *("abc", "1-2", "0x10", "1.2.3", "1e", "+", "-.", "\u0661", "1 2", "/", "\ufeff1"),
]
TEXTS = [
    *("walk", "", "NA", "stairs", '5" pipe', '"a,b"', '"he said ""go"""', "\u00b0C", ' "x,y"'),
    '"two\nlines"',
]
OPEN = ['"', '"open', 'a"b"c', '"closed" early', '"three\n\nlines"', '""', '"""']
OTHERS = ["", "   ", "x", "a,b", "1,2,3,4,5,6", ",,,,", ",,,", "\ufeff", '"', ',"', '",,,,"']

row_texts = st.builds(
    lambda *cells: ",".join(cells),
    *map(st.sampled_from, (TIMES, NUMBERS, NUMBERS, TEXTS + OPEN, TEXTS + OPEN)),
)
sound_texts = st.builds(
    lambda *cells: ",".join(cells),
    *map(st.sampled_from, (TIMES[:4], NUMBERS[:3], NUMBERS[:3], TEXTS[:3], TEXTS[:3])),
)
some_lines = st.lists(
    st.one_of(row_texts, sound_texts, sound_texts, st.sampled_from(OTHERS)), min_size=1, max_size=40
)


def encoded(line: str, latin: bool) -> bytes:
    try:
        return line.encode("latin-1" if latin else "utf-8")
    except UnicodeEncodeError:
        return line.encode()


@settings(max_examples=400, deadline=None)
@given(texts=some_lines, returns=st.booleans(), latin=st.booleans(), seed=st.integers(0, 1 << 30))
def test_rows_are_those_of_a_reader_in_plain_python_whatever_the_blocks(
    texts: list[str], returns: bool, latin: bool, seed: int
) -> None:
    """Ragged lines, wrong cells, quotes and blank lines in every combination, cut anywhere, in any order."""
    lines = "\n".join(texts).split("\n")
    end = b"\r\n" if returns else b"\n"
    data = b"".join(encoded(line, latin) + end for line in lines)
    expected = by_hand(lines)
    assert rows_of(parsed(data)) == expected
    chance, parser = random.Random(seed), LineParser(Path("a.csv"), dialect())
    cutter, blocks, place = LineCutter(Path("a.csv"), 0, 1, dialect().quotes), [], 0
    while place < len(data):
        size = chance.choice((1, 7, 40, 300))
        if cut := cutter.cut([data[place : place + size]]):
            blocks.append(cutter.block(cut, False))
        place += size
    blocks.append(cutter.block(b"", True))
    order = sorted(range(len(blocks)), key=lambda _: chance.random())
    found = {block: parser.parse(blocks[block], WANTED) for block in order}
    assert rows_of(*(found[block] for block in range(len(blocks)))) == expected


# Single facts


def told(found: Block) -> dict[int, str]:
    """What is wrong with lost rows, by their line."""
    return {int(found.line[row]): why for row, why in found.bad.items()}


SOUND = "2024-03-04T00:00:00.5,0.5,-1,walk,a\n"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("2024-03-04,1,abc,walk,a", "column 2 holds 'abc', which is not a number"),
        ("2024-03-04,1-2,abc,walk,a", "column 1 holds '1-2', which is not a number"),
        ("last week,1,abc,walk,a", "column 0 holds 'last week', which is not a time"),
        ("2024-03-04T10:41:40Z,1,1,walk,a", "column 0 holds '2024-03-04T10:41:40Z', which is not a time"),
        ("2024-03-04,1,walk,a", "the line has 4 columns, not 5 ('2024-03-04,1,walk,a')"),
        ("2024-03-04", "the line has 1 column, not 5 ('2024-03-04')"),
        ("2024-03-04,1,1,walk,a,\u00e4", "the line has 6 columns, not 5 ('2024-03-04,1,1,walk,a,\u00e4')"),
        ("2024-03-04,1," + "7" * 50 + "x,walk,a", f"column 2 holds '{'7' * 40}...', which is not a number"),
        ('2024-03-04,"1,1,walk,a', "the line has 2 columns, not 5 ('2024-03-04,\"1,1,walk,a')"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_what_is_wrong_with_a_line_is_told(line: str, why: str, encoding: str) -> None:
    found = parsed((SOUND * 3 + "\n" + line + "\n" + SOUND).encode(encoding))
    assert found.line.tolist() == [1, 2, 3, 5, 6]
    assert told(found) == {5: why}
    assert plain(found.values[1]) == [0.5, 0.5, 0.5, None, 0.5]


def test_of_many_stretches_of_lost_rows_the_first_are_explained() -> None:
    found = parsed((SOUND + "x\ny\n") * 100)
    whys = [*told(found).items()]
    why = "the line has 1 column, not 5 ('x')"
    assert whys[:4] == [(2, why), (3, NOT_ROWS), (5, why), (6, NOT_ROWS)]
    assert len(whys) == 200
    assert [text for _, text in whys].count(NOT_ROWS) == 200 - 64


def test_times_with_a_zone_and_those_that_do_not_exist() -> None:
    cells = ["2024-03-04T00:00:00+01:00", "2024-03-03T23:00Z", "2024-02-30T00:00:00Z", "", "2024-03-04"]
    cells += ["2024-03-03T22:59:60Z", "2262-04-11T23:47:16.854775Z", "2262-04-11T23:47:17Z"]
    found = parsed("".join(f"{cell},1,2\n" for cell in cells), dialect(3), {0: As.ZONED_MOMENT})
    begin = START_US - 3_600_000_000
    assert found.values[0].tolist() == [
        *(begin, begin, IMPOSSIBLE, NO_TIME, NO_TIME, begin, 9_223_372_036_854_775, IMPOSSIBLE)
    ]
    assert told(found) == {5: "column 0 holds '2024-03-04', which is not a time"}


def test_a_number_too_small_or_too_large_is_the_nearest_there_is() -> None:
    found = parsed("1e-400,1e400,-1e400\nx,y,z\n", dialect(3), dict.fromkeys(range(3), As.NUMBER))
    assert [found.values[column][0] for column in range(3)] == [0.0, math.inf, -math.inf]


def test_returns_alone_end_lines_and_are_not_counted() -> None:
    found = parsed("1,2,3\r4,5,6\n\n7,8,9\r\r\nx\r\nx,2,3\r7,7,7", dialect(3), {0: As.NUMBER})
    assert plain(found.values[0]) == [1, 4, 7, None, None, 7]
    assert found.line.tolist() == [1, 1, 3, 4, 5, 5]
    assert [*told(found)] == [4, 5]


@pytest.mark.parametrize(
    ("layout", "text"),
    [
        (dialect(3, ";", comma="."), "0,5;1;2\nx;1;2\n1,5;1;2\n"),
        (dialect(3, ";", comma=".", padded=True), "0,5 ; 1 ; 2\nx ; 1 ; 2\n 1,5;1;2\n"),
        (dialect(3, "\t"), "0.5\t1\t2\nx\t1\t2\n1.5 \t1\t2\n"),
        (dialect(3, " "), " 0.5  1 2\nx\t1 2\n1.5 1 2\n"),
    ],
)
def test_every_delimiter(layout: Dialect, text: str) -> None:
    found = parsed(text, layout, {0: As.NUMBER, 2: As.NUMBER})
    assert plain(found.values[0]) == [0.5, None, 1.5]
    assert plain(found.values[2]) == [2, None, 2]
    assert told(found) == {2: "column 0 holds 'x', which is not a number"}


def test_a_date_inside_a_block_that_others_end_as() -> None:
    days = ["4.3.2024", "14.3.2024", "5.3.2024", "x", "4.3.2024"]
    text = "".join(f"{day} 10:00:00,1,2\n" for day in days)
    found = parsed(text, dialect(3, date_order="dmy"), {0: As.MOMENT})
    ten, day = START_US + 36_000_000_000, 86_400_000_000
    assert plain(found.values[0]) == [ten, ten + 10 * day, ten + day, None, ten]
    assert [*told(found)] == [4]


@pytest.mark.parametrize("text", ["", "\n", "\r\n \n\n", "   "])
def test_a_block_without_rows(text: str) -> None:
    found = parsed(text)
    assert (len(found.line), found.bad) == (0, {})
    assert {column: len(plain(values)) for column, values in found.values.items()} == dict.fromkeys(WANTED, 0)


def test_a_block_of_lost_rows_alone() -> None:
    assert rows_of(parsed("x\ny,z\n")) == [(1, None), (2, None)]


def test_a_line_longer_than_what_arrow_parses_at_a_time() -> None:
    long = "2024-03-04,1,2,walk," + "a" * 1_000_000 + "\n"
    found = parsed(long + SOUND + "x\n" + long)
    assert [len(text or "") for text in plain(found.values[4])] == [1_000_000, 1, 0, 1_000_000]


# Quotes


def test_a_cell_in_quotes_over_several_lines_is_one_row() -> None:
    text = SOUND + '2024-03-04,1,2,"sat down,\nthen up",b\n' + SOUND + '2024-03-04,3,4,"\n\n\n",c\n' + SOUND
    found = parsed(text)
    assert found.line.tolist() == [1, 2, 4, 5, 9]
    assert plain(found.values[1]) == [0.5, 1, 0.5, 3, 0.5]
    assert found.values[3].texts == ("walk", "sat down, then up")
    assert found.values[3].codes.tolist() == [0, 1, 0, -1, 0]
    assert found.bad == {}


LONE = '2024-03-04,1,2,walk,"\n'


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (LONE + SOUND * 100, 101),
        (SOUND + LONE + LONE + SOUND + LONE, 5),
        (SOUND + '2024-03-04,1,2,"walk,a\n' + SOUND, 3),
    ],
)
def test_a_quote_that_is_never_closed_is_a_letter(text: str, lines: int) -> None:
    found = parsed(text)
    assert found.line.tolist() == [*range(1, lines + 1)]
    assert found.bad == {}


def test_a_quote_that_is_never_closed_costs_its_line_at_most() -> None:
    found = parsed(SOUND + '2024-03-04,"1,2,walk,a\n' + SOUND * 100)
    assert [*told(found)] == [2]
    assert len(found.line) == 102


@pytest.mark.parametrize("more", [MOST_JOINED, MOST_JOINED + 1])
def test_a_cell_reaches_over_so_many_lines(more: int) -> None:
    found = parsed(SOUND + '2024-03-04,1,2,"a' + "\nx" * (more - 1) + '\nz",b\n' + SOUND)
    assert len(found.line) == (3 if more == MOST_JOINED else more + 3)
    assert found.line[-1] == more + 3
    assert len(found.bad) == (0 if more == MOST_JOINED else more + 1)


@pytest.mark.parametrize("chunk_samples", [1, 7, 100_000])
def test_t4_a_note_over_two_lines(tmp_path: Path, chunk_samples: int) -> None:
    lines = [f"{stamp(number * 10_000)},0,0,1,{'go' * (number % 3)}\n" for number in range(400)]
    lines[150] = f'{stamp(1_500_000)},0,0,1,"sat down,\nthen up"\n'
    lines[300] = f"{stamp(3_000_000)},0,0,x,\n"
    found = read(written(tmp_path, "time,x,y,z,note\n" + "".join(lines)), chunk_samples)
    assert (len(found.counts), found.breaks) == (399, [300])
    assert np.diff(found.times).tolist() == [10_000] * 299 + [20_000] + [10_000] * 98
    (problem,) = found.problems
    assert problem.told == "1 row left out: column 3 holds 'x', which is not a number, from line 303 on"


@pytest.mark.parametrize("chunk_samples", [1, 7, 100_000])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("sensor", [None, "all"])
def test_t4_a_lone_quote_hides_no_row(
    tmp_path: Path, chunk_samples: int, packed: bool, sensor: str | None
) -> None:
    lines = [f"{stamp(number * 10_000)},0,0,1,{'ab'[number % 2]}\n" for number in range(400)]
    lines[100], lines[380] = f'{stamp(1_000_000)},0,0,1,"\n', f'{stamp(3_800_000)},0,0,1,"b\n'
    data = ("time,x,y,z,note\n" + "".join(lines)).encode()
    path = written(tmp_path, gzip.compress(data) if packed else data, "a.csv.gz" if packed else "a.csv")
    found = read(path, chunk_samples, sensor=sensor)
    assert (len(found.counts), found.breaks, found.codes) == (400, [], [])


def test_t4_a_lone_quote_among_two_sensors(tmp_path: Path) -> None:
    lines = [f"{stamp(number // 2 * 10_000)},{'lr'[number % 2]}eft,0,0,1,\n" for number in range(400)]
    lines[102] = lines[102].removesuffix("\n") + '"\n'
    path = written(tmp_path, "time,location,x,y,z,note\n" + "".join(lines))
    found = read(path, sensor="left")
    assert (len(found.counts), found.codes) == (200, [])


# What damage costs


@dataclass(frozen=True)
class Table:
    """A text, how many lines below its head there are, and how many of them are no rows."""

    path: Path
    lines: int
    bad: int


def table(folder: Path, rows: int, share: float) -> Table:
    """A file in which a share of the lines is ragged, or has a number or a time that is none."""
    chance, lines, bad = random.Random(7), ["time,x,y,z\n"], 0
    for row in range(rows):
        cells = [stamp(row * 10_000), *(f"{chance.uniform(-1, 1):.4f}" for _ in "xyz")]
        if chance.random() < share:
            bad += 1
            kind = chance.randrange(3)
            if kind == 0:
                cells = cells[: chance.randint(1, 3)] if chance.random() < 0.5 else [*cells, "7"]
            else:
                cells[chance.randint(1, 3) if kind == 1 else 0] = chance.choice(["abc", "1-2", "0x10", "1e"])
        lines.append(",".join(cells) + "\n")
    return Table(written(folder, "".join(lines), f"{share}.csv"), rows, bad)


def cost(one: Table) -> float:
    """CPU seconds in which a file is read."""
    with open_recording(one.path, ReadOptions(unit="g")) as reader:
        begin = time.process_time()
        kept = sum(len(chunk) for chunk in reader.chunks(1 << 17))
        spent = time.process_time() - begin
    assert kept == one.lines - one.bad
    return spent


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_bad_lines_cost_little(tmp_path: Path, share: float) -> None:
    """A file with them takes about twice the CPU of a sound one; halving took over a hundred times as much.

    The limit leaves room for what else a machine does meanwhile.
    """
    sound, bad = table(tmp_path, 200_000, 0), table(tmp_path, 200_000, share)
    cost(bad)  # imports
    pairs = [(cost(sound), cost(bad)) for _ in range(3)]
    assert min(spent for _, spent in pairs) <= 3 * min(spent for spent, _ in pairs)

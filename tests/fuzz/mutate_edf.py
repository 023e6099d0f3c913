"""Damaged EDF, EDF+ and BDF files: fields of the header, records, and times of EDF+D."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from random import Random

import numpy as np

from tests.formats import make_edf
from tests.formats.make_edf import Signal
from tests.fuzz.blind import blind
from tests.fuzz.mutant import ORDER, Change, Mutant, Records, Truth, broken, changed, stretch, together

SUFFIX = ".edf"
SAMPLES, RECORDS = 25, 40
LIMITS = ("-8", "8", -2048, 2048)
FIELDS = {
    "header": (184, 8),
    "reserved": (192, 5),
    "records": (236, 8),
    "seconds": (244, 8),
    "signals": (252, 4),
}
TEXTS = (
    *(
        b"",
        b"0",
        b"-1",
        b"1",
        b"1e99",
        b"nan",
        b"inf",
        b"9" * 8,
        b"-9999999",
        b"0.0001",
        b"1e-5",
        b"1e8",
        b"1,5",
    ),
    *(
        b"\x1b[31mX",
        b"\xff" * 8,
        b"\0" * 8,
        b"EDF+D",
        b"EDF+C",
        b"12 34",
        b"+5",
        b".5",
        b"5.",
        b"1/3",
        b"mg",
        b"g",
    ),
    *(b"x", b"Acc X", b"deg/s", b"10", b"26", b"256", b"1280", b"16777216", b"100000", b"\xb2"),
)
ONSETS = (b"+0", b"+1e9", b"-5", b"+999999999", b"+3.999999999", b"x", b"", b"+12", b"+5\x151\x14a", b"+\xb2")


@dataclass(frozen=True)
class Made:
    """A sound file in pieces: times are given by records if it is EDF+D."""

    header: bytes
    records: tuple[bytes, ...]
    sample_bytes: int
    timed: bool


@cache
def recordings() -> tuple[Made, ...]:
    counts = np.random.RandomState(4).randint(-2048, 2048, (SAMPLES * RECORDS, 3))
    signals = make_edf.xyz(counts, SAMPLES)
    texts = [f"+{number + 20 * (number > 30)}" for number in range(RECORDS)]
    warm = Signal("Temperature", "degC", ("0", "50", 0, 500), np.full((RECORDS, 1), 300))
    made = []
    for reserved, bdf in (("", False), ("EDF+C", False), ("EDF+D", False), ("", True)):
        parts = [*signals, warm, *([make_edf.onsets(texts)] if reserved else [])]
        head = make_edf.header(parts, reserved=reserved, bdf=bdf)
        made.append(Made(head, tuple(make_edf.records(parts, bdf)), 2 + bdf, reserved == "EDF+D"))
    return tuple(made)


def onset(records: Records, random: Random) -> None:
    where = stretch(records, random, (1, 3, 100))
    text = random.choice(ONSETS) + b"\x14\x14\0"
    at = 2 * (3 * SAMPLES + 1)
    records[where] = [one[:at] + text + one[at + len(text) :] for one in records[where]]


def short(records: Records, random: Random) -> None:
    """A record lacks some bytes: all behind it are shifted."""
    at = random.randrange(len(records))
    records[at] = records[at][: random.randrange(len(records[at]))]


def field(head: bytes, random: Random) -> bytes:
    signals = len(head) // 256 - 1
    place, width = random.choice([*FIELDS.values(), (168, 8), (176, 8), (8, 80), (88, 80)])
    if random.random() < 0.6:
        before, width = random.choice([(0, 16), (96, 8), (104, 8), (112, 8), (120, 8), (128, 8), (216, 8)])
        place = 256 + signals * before + width * random.randrange(signals)
    text = random.choice(TEXTS)[:width].ljust(width)
    return head[:place] + text + head[place + width :]


RECORD_CHANGES: tuple[Change, ...] = (*ORDER, broken)


def mutant(random: Random) -> Mutant:
    made = random.choice(recordings())
    if random.random() < 0.25:
        return Mutant(blind(made.header + b"".join(made.records), random), "blind")
    records = list(made.records)
    if random.random() < 0.4:
        what = changed(records, random, RECORD_CHANGES)
        data = made.header + b"".join(records)
        if random.random() < 0.3:
            what, data = f"{what} cut", data[: random.randrange(len(made.header), len(data))]
        return Mutant(data, what, truth(data, made))
    what = changed(records, random, (*RECORD_CHANGES, onset, onset, short))
    head = made.header
    for _ in range(random.choice([0, 1, 1, 2, 4])):
        head, what = field(head, random), f"{what} field"
    return Mutant(head + b"".join(records), what)


def truth(data: bytes, made: Made) -> Truth:
    """Rows of the whole records; EDF+D leaves out those whose time is damaged."""
    size = len(made.records[0])
    body = data[len(made.header) :]
    parts, damaged = [], int(len(body) % size > 0)
    for at in range(0, len(body) - size + 1, size):
        record = body[at : at + size]
        if made.timed and not sound_onset(record[2 * (3 * SAMPLES + 1) :]):
            damaged += 1
            continue
        parts.append(rows_of(record, made.sample_bytes))
    rows = together(parts)
    return Truth(rows, rows, damaged)


def sound_onset(data: bytes) -> bool:
    """Whether these bytes begin with a time."""
    text, found, _ = data.partition(b"\x14")
    whole, _, fraction = text[1:].partition(b".")
    plain = all(part.isascii() and (part == b"" or part.isdigit()) for part in (whole, fraction))
    return bool(found) and text[:1] in (b"+", b"-") and plain and 1 <= len(whole) <= 9 and len(fraction) <= 9


def rows_of(record: bytes, sample_bytes: int) -> np.ndarray:
    values = [
        int.from_bytes(record[at : at + sample_bytes], "little", signed=True)
        for at in range(0, 3 * SAMPLES * sample_bytes, sample_bytes)
    ]
    return np.array(values, float).reshape(3, SAMPLES).T / 256

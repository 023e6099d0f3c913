"""Damaged raw dumps: layouts of any kind, sound ones and absurd ones, and the pages that they describe."""

from __future__ import annotations

import struct
import zlib
from binascii import crc_hqx
from dataclasses import dataclass
from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.fuzz.blind import blind
from tests.fuzz.mutant import ORDER, Change, Mutant, Records, Truth, broken, changed, stretch, together

SUFFIX = ".raw"
ROWS = 480
RATE = 50
START_S = 1_709_510_400
LARGEST_G = 100.0
UNUSED_FRAMES = 8
TYPES = {"int8": "b", "int16": "h", "int24": "", "int32": "i", "float32": "f", "uint16": "H", "uint8": "B"}
SIZES = {"int8": 1, "int16": 2, "int24": 3, "int32": 4, "float32": 4, "uint16": 2, "uint8": 1}
NUMBERS = (
    *(
        "0",
        "1",
        "-1",
        "50",
        "100000",
        "1e5",
        "0.001",
        "1e-9",
        "1e308",
        "-1e308",
        "nan",
        "inf",
        "-inf",
        "true",
    ),
    *('"25"', "[]", "{}", "256.0", "1e12", "1e-6", "9" * 30, "9" * 5000, "0x10", "2024-03-04T00:00:00"),
    *("1979-05-27", "12:00:00", "0b1", "1_000", "-0.0", '"\\u001b[31m"', "1e400"),
)
PLACES = (
    *("0", "2", "1", "-1", "8", "500", "508", "65535", "65536", "1099511627776", "9223372036854775807"),
    *("18446744073709551616", "1.5", "true", '"2"', "nan", "[]"),
)
STARTS = (
    *('"2024-03-04T00:00:00+14:00"', '"9999-12-31T23:59:59"', '"0001-01-01T00:00:00"', '"x"', '""'),
    *('"0001-01-01T00:00:00+01:00"', '"9999-12-31T23:59:59-01:00"', '"1969-12-31"', "2024-03-04T00:00:00Z"),
)
TEXTS = (
    '"\\u001b[31m\\u0007"',
    '"\\u0000"',
    '"\\n"',
    '""',
    '"=1+1"',
    "5",
    '"\\u202e"',
    '"' + "s" * 500 + '"',
)
MORE = (
    *(
        "[x]",
        "[[dump]]",
        "a=1",
        "[dump.b]\nc=1",
        "\x00",
        '"\\u001b[31m"=1',
        "[" * 900,
        "a" + ".a" * 490 + "=1",
    ),
    *("b = " + "[" * 400, "a" + ".a" * 20_000 + "=1", "x" * 70_000, '"' * 5, "\ufeff"),
)


@dataclass(frozen=True)
class Plan:
    """A sound layout; sizes in bytes, `page` 0 for a stream."""

    kind: str
    endian: str
    scale: float
    gap: int
    header: int
    page: int
    crc: str
    numbered: bool

    @property
    def frame(self) -> int:
        return 3 * SIZES[self.kind] + self.gap

    @property
    def page_rows(self) -> int:
        return (self.page - 16) // self.frame if self.page else 60

    def text(self) -> str:
        size = SIZES[self.kind]
        lines = ["[dump]", f"rate_hz = {RATE}.0", f"lsb_per_g = {self.scale!r}", f'endian = "{self.endian}"']
        lines += [f"frame_bytes = {self.frame}", f"header_bytes = {self.header}", 'serial = "7"']
        lines += ['start_time = "2024-03-04T00:00:00"', "range_g = 8.0"]
        if self.page:
            lines += [f"page_bytes = {self.page}", "page_header_bytes = 12", "page_trailer_bytes = 4"]
        lines.append("[fields]")
        lines += [f'{axis} = {{ offset = {k * size}, type = "{self.kind}" }}' for k, axis in enumerate("xyz")]
        lines += ["[page]"] if self.page and (self.crc or self.numbered) else []
        if self.page and self.numbered:
            lines.append('sequence = { offset = 0, type = "uint32" }')
            lines.append('time = { offset = 4, type = "uint32", per_unit = 1.0 }')
        if self.page and self.crc:
            span = f"covers = [0, {self.page - 4}]"
            lines.append(f'crc = {{ offset = {self.page - 4}, type = "{self.crc}", {span} }}')
        return "\n".join(lines) + "\n"


@cache
def counts() -> np.ndarray:
    return np.random.RandomState(11).randint(-120, 120, (ROWS, 3))


@cache
def plans() -> tuple[Plan, ...]:
    """Every kind of number in streams and in pages."""
    found = []
    for kind in ("int8", "int16", "int24", "int32", "float32"):
        scale = 0.25 if kind == "float32" else 64.0
        for endian in ("little", "big"):
            found.append(Plan(kind, endian, scale, 0, 6, 0, "", False))
            found.append(Plan(kind, endian, scale, 2, 0, 512, "crc32", True))
            found.append(Plan(kind, endian, scale, 1, 512, 256, "crc16-ccitt", False))
            found.append(Plan(kind, endian, scale, 0, 0, 512, "", True))
    return tuple(found)


def coded(value: int, plan: Plan) -> bytes:
    if plan.kind == "int24":
        return int(value).to_bytes(3, "little" if plan.endian == "little" else "big", signed=True)
    mark = "<" if plan.endian == "little" else ">"
    return struct.pack(mark + TYPES[plan.kind], value / 256 if plan.kind == "float32" else int(value))


@cache
def pages(plan: Plan) -> tuple[bytes, ...]:
    """The dump in pages, or a stream in stretches of so many frames."""
    frames = [b"".join(coded(v, plan) for v in row) + b"\xee" * plan.gap for row in counts().tolist()]
    size = plan.page_rows
    bodies = [b"".join(frames[at : at + size]) for at in range(0, len(frames) // size * size, size)]
    if not plan.page:
        return tuple(bodies)
    return tuple(page(plan, number, body) for number, body in enumerate(bodies))


def page(plan: Plan, number: int, body: bytes) -> bytes:
    mark = "<" if plan.endian == "little" else ">"
    when = START_S + number * plan.page_rows // RATE
    head = struct.pack(mark + "III", number, when, 0)
    return sealed(plan, (head + body).ljust(plan.page - 4, b"\0"))


def sealed(plan: Plan, body: bytes) -> bytes:
    mark = "<" if plan.endian == "little" else ">"
    if plan.crc == "crc16-ccitt":
        return body + struct.pack(mark + "H", crc_hqx(body, 0xFFFF)) + b"\0\0"
    return body + struct.pack(mark + "I", zlib.crc32(body))


def page_changes(plan: Plan) -> tuple[Change, ...]:
    """Changes of single pages, or stretches of a stream, of a plan."""
    mark = "<" if plan.endian == "little" else ">"

    def field(parts: Records, random: Random) -> None:
        """Numbers and times go on elsewhere."""
        where, at = stretch(parts, random, (1, 2, 1000)), random.choice([0, 4])
        first = random.choice([0, (1 << 32) - 2, random.getrandbits(32), START_S + 3600])
        for k in range(where.start, where.stop):
            new = bytearray(parts[k][:-4])
            struct.pack_into(mark + "I", new, at, first + k & 0xFFFFFFFF)
            parts[k] = sealed(plan, bytes(new))

    def blank(parts: Records, random: Random) -> None:
        """Zeros, erased memory or noise."""
        at = random.randrange(len(parts))
        size = len(parts[at])
        parts[at] = random.choice([bytes(size), b"\xff" * size, random.randbytes(size)])

    return (*ORDER, blank, broken, *((field, field) if plan.page else ()))


def mutant(random: Random) -> Mutant:
    plan = random.choice(plans())
    parts = list(pages(plan))
    head = bytes(range(plan.header % 256)).ljust(plan.header, b"h")
    choice = random.random()
    if choice < 0.5:
        what = changed(parts, random, page_changes(plan))
        data = head + b"".join(parts)
        if random.random() < 0.1:
            data = data[: random.randrange(1, 2 + len(data))]
        return Mutant(data, f"{plan} {what}", truth(plan, data), layout=plan.text().encode())
    if choice < 0.65:
        data = blind(head + b"".join(parts), random)
        return Mutant(data, f"{plan} blind", truth(plan, data), layout=plan.text().encode())
    text = damaged_layout(plan.text(), random)
    options = random.choice([ReadOptions()] * 4 + [ReadOptions(rate_hz=50.0), ReadOptions(lsb_per_g=64.0)])
    data = head + b"".join(parts)
    if random.random() < 0.3:
        data = random.choice([blind(data, random), floats(), b"\xff" * 600, b"\0", random.randbytes(900)])
    return Mutant(data, "layout", None, options, text.encode("utf-8", "surrogatepass"))


def floats() -> bytes:
    return np.array([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, 0.5] * 100, "f4").tobytes()


def damaged_layout(text: str, random: Random) -> str:
    lines = text.splitlines()
    for _ in range(random.choice([1, 1, 2, 4])):
        at = random.randrange(len(lines))
        key, sign, value = lines[at].partition(" = ")
        form = random.random()
        if form < 0.15:
            lines.insert(at, random.choice(MORE))
        elif form < 0.25:
            del lines[at]
        elif "{" in value:
            lines[at] = f"{key} = {odd_field(random)}"
        elif sign:
            lines[at] = f"{key} = {random.choice(values_for(key))}"
        if not lines:
            break
    damaged = "\n".join(lines) + "\n"
    if random.random() < 0.05:
        damaged = damaged[: random.randrange(len(damaged))]
    return damaged


def values_for(key: str) -> tuple[str, ...]:
    """What a key may absurdly be."""
    if key == "start_time":
        return (*STARTS, *NUMBERS)
    if key in ("serial", "endian"):
        return (*TEXTS, '"big"', '"x"')
    return NUMBERS if key in ("rate_hz", "lsb_per_g", "range_g") else (*PLACES, *NUMBERS)


def odd_field(random: Random) -> str:
    """An inline table."""
    kind = random.choice(
        [*(f'"{name}"' for name in TYPES), '"crc32"', '"uint32"', '""', '"\\u001b[31m"', "5"]
    )
    parts = [f"offset = {random.choice(PLACES)}", f"type = {kind}"]
    if random.random() < 0.4:
        parts.append(f"{random.choice(['per_unit', 'zero'])} = {random.choice(NUMBERS)}")
    if random.random() < 0.2:
        parts.append(
            random.choice(["covers = [0, 508]", "covers = [9, -1]", "covers = [[]]", '"\\u001b" = 1'])
        )
    return "{ " + ", ".join(parts) + " }"


def truth(plan: Plan, data: bytes) -> Truth | None:
    """Rows of whole pages whose checksum is right, or of all whole frames of a stream.

    Eight or more frames of FF at the end of a page are none. What erased memory without a checksum means,
    nobody can tell, nor what floats do that are none.
    """
    body = data[plan.header :]
    if not plan.page:
        rows = frame_rows(plan, body)
        usual = plan.kind != "float32" or (np.abs(rows) < LARGEST_G).all()
        return Truth(rows, rows) if usual and b"\xff" * plan.frame not in body else None
    parts = [body[at : at + plan.page] for at in range(0, len(body), plan.page)]
    sound = [len(part) == plan.page and checks(plan, part) for part in parts]
    pages = [part for part, right in zip(parts, sound, strict=True) if right]
    rows = together([page_rows(plan, page) for page in pages])
    bad = sum(bool(part.strip(b"\xff")) and not right for part, right in zip(parts, sound, strict=True))
    if plan.kind == "float32" and not (np.abs(rows) < LARGEST_G).all():
        return None
    if plan.crc:
        return Truth(together([used_rows(plan, page) for page in pages]), rows, bad)
    return Truth(rows[(rows != frame_rows(plan, b"\xff" * plan.frame)).any(axis=1)], rows, bad)


def page_rows(plan: Plan, part: bytes) -> np.ndarray:
    return frame_rows(plan, part[12 : 12 + plan.page_rows * plan.frame])


def used_rows(plan: Plan, part: bytes) -> np.ndarray:
    """Rows of a page without those that were never written."""
    rows, frames = page_rows(plan, part), part[12 : 12 + plan.page_rows * plan.frame]
    used = -(-len(frames.rstrip(b"\xff")) // plan.frame)
    return rows[:used] if plan.page_rows - used >= UNUSED_FRAMES else rows


def checks(plan: Plan, part: bytes) -> bool:
    """Whether a page has no checksum, or the right one."""
    end = {"": -4, "crc32": -4, "crc16-ccitt": -4}[plan.crc]
    wanted = sealed(plan, part[:end])[end:]
    size = 2 if plan.crc == "crc16-ccitt" else 4
    return not plan.crc or part[end : len(part) + end + size] == wanted[:size]


def frame_rows(plan: Plan, body: bytes) -> np.ndarray:
    size = SIZES[plan.kind]
    raw = np.frombuffer(body, np.uint8, len(body) // plan.frame * plan.frame).reshape(-1, plan.frame)
    octets = np.ascontiguousarray(raw[:, : 3 * size]).reshape(-1, 3, size)
    if plan.kind == "float32":
        with np.errstate(invalid="ignore"):
            values = octets.view("<f4" if plan.endian == "little" else ">f4")[:, :, 0].astype(float)
        return values / plan.scale
    if plan.endian == "big":
        octets = octets[:, :, ::-1]
    whole = sum(octets[:, :, k].astype(np.int64) << 8 * k for k in range(size))
    top = 1 << 8 * size - 1
    return ((whole ^ top) - top) / plan.scale

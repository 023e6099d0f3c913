"""Damaged archives and exports of phones: one recording, several, an export, hostile members.

An archive that is cut or damaged gives the members before the damage, or is refused; whatever it says, it
costs what a recording of its size costs, and no message names a temporary file.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import tarfile
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

import numpy as np

from accelcal_cli.core.errors import AccelcalError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import archive_around, open_recording
from tests.formats import make_gt3x
from tests.fuzz.blind import blind, replace_number
from tests.fuzz.reading import checked

if TYPE_CHECKING:
    from tests.fuzz.engine import Tally

NUMBERS = (0, 1, 0xFFFF, 0xFFFFFFFF, 1 << 31, 1 << 40, (1 << 64) - 1)
NAMES = (
    "a.csv",
    "Gyroscope.csv",
    "TotalAcceleration.csv",
    "meta/time.csv",
    "x/../../b.csv",
    "d/",
    "unisens.xml",
)
KINDS = (b"0", b"5", b"2", b"L", b"K", b"x", b"g", b"S", b"7", b"V")
PAX = (
    b"22 GNU.sparse.major=1\n",
    b"12 size=500\n",
    b"16 path=b/c.csv\n",
    b"12 size=-99\n",
    b"9 path=\n",
    b"99 x",
)


@cache
def table(start_s: int = 0, names: str = "time,seconds_elapsed,z,y,x") -> bytes:
    lines = [names]
    for row in range(200):
        time_ns = 1_709_548_900_123_000_000 + start_s * 10**9 + row * 40_000_000
        lines.append(f"{time_ns},{row / 25},{9.7 + row / 1000:.3f},{row % 7 / 100},{row % 5 / 100}")
    return ("\n".join(lines) + "\n").encode()


@cache
def gt3x() -> bytes:
    counts = np.random.RandomState(11).randint(-500, 500, (90, 3)).astype(np.int16)
    parts = {"info.txt": make_gt3x.info(30), "log.bin": b"".join(make_gt3x.seconds(counts, 30))}
    return make_gt3x.zipped(parts)


def members(random: Random) -> list[tuple[str, bytes]]:
    time_csv = b'"event","experiment time","system time"\n"START",0,1.7E9\n'
    contents = (
        table(),
        table(9),
        gt3x(),
        b"",
        b"<unisens/>",
        time_csv,
        table()[:3000],
        random.randbytes(300),
    )
    number = random.randint(1, 6)
    return [(random.choice(NAMES), random.choice(contents)) for _ in range(number)]


def zipped(random: Random) -> bytes:
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w") as made:
        warnings.simplefilter("ignore")
        for name, data in members(random):
            info = zipfile.ZipInfo(name)
            info.compress_type = random.choice((0, 8, 8, 8, 12, 14))
            with made.open(info, "w", force_zip64=random.random() < 0.3) as member:
                member.write(b"" if name.endswith("/") else data)
    data = bytearray(file.getvalue())
    places = [at for at in range(len(data)) if data.startswith(b"PK", at)]
    for _ in range(random.randrange(4)):
        at = min(random.choice(places) + random.randrange(4, 46), len(data) - 8)
        replace_number(data, at, NUMBERS, random)
    return bytes(data)


def tarred(random: Random) -> bytes:
    blocks = b""
    for name, data in members(random):
        kind = random.choice(KINDS) if random.random() < 0.4 else b"0"
        body = random.choice(PAX) if kind in b"xgLK" else data
        info = tarfile.TarInfo(name.rstrip("/"))
        info.type, info.size = kind, random.choice(NUMBERS) if random.random() < 0.1 else len(body)
        blocks += info.tobuf(tarfile.GNU_FORMAT) + body + bytes(-len(body) % 512)
    blocks += bytes(random.choice((0, 512, 1024, 10_240)))
    return random.choice((bytes, gzip.compress, bz2.compress, lzma.compress))(blocks)


def archives(folder: Path) -> Callable[[Random, int, Path, Tally], tuple[bytes, str, str | None]]:
    def attempt(random: Random, _number: int, _folder: Path, tally: Tally) -> tuple[bytes, str, str | None]:
        is_zip = random.random() < 0.5
        data = zipped(random) if is_zip else tarred(random)
        if random.random() < 0.6:
            data = blind(data, random)
        path = folder / f"mutant{'.zip' if is_zip else '.tar'}"
        path.write_bytes(data or b"\0")
        return data, "zip" if is_zip else "tar", judged(path, tally, joined=random.random() < 0.5)

    return attempt


def judged(path: Path, tally: Tally, *, joined: bool) -> str | None:
    """Read all rows of an archive; what an error says must be about it."""
    with suppress(AccelcalError):
        archive_around(path)
    temporary = set(Path(tempfile.gettempdir()).iterdir())
    try:
        with open_recording(path, ReadOptions(), joined=joined) as reader:
            chunks = list(checked(reader.chunks(300), reader.recording.total_bytes))
            tally.rows += sum(map(len, chunks))
            said = str([one.message for chunk in chunks for one in chunk.problems])
    except AccelcalError as error:
        tally.refused += 1
        said = str(error)
        if path.stem not in said:
            return f"an error without the file's name: {said}"
    left = set(Path(tempfile.gettempdir()).iterdir()) - temporary
    if left:
        return f"LEFT BEHIND: {sorted(left)}"
    return f"NAMES A TEMPORARY FILE: {said}" if "accelcal-" in said.replace(str(path.parent), "") else None

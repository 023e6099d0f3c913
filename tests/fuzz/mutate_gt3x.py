"""Damaged ActiGraph recordings: records and info.txt changed, whole again; and the zip file itself."""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
import zipfile
from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_gt3x
from tests.formats.make_gt3x import ACTIVITY, ACTIVITY2, ACTIVITY3, START_S, record
from tests.fuzz.blind import blind
from tests.fuzz.mutant import ORDER, Change, Mutant, Records, Truth, changed, flip, stretch, together

SUFFIX = ".gt3x"
RATE = 30
SIX_G = 341.0
"""Counts per g of the older kind, which does not say it."""

PAIR_BYTES = 9
"""Length of two packed samples."""

LARGEST_G = 127.0
"""Values behind a calibration.json are cut off there."""

FRAME = 9
LONGEST = 65_535
SEPARATOR = 0x1E
JUMPS_S = (1, -1, 2, -5, 60, -60, 3600, -3600, 86_400, -86_400 * 300, 86_400 * 7300, 10**9, 1 << 31)
KINDS = (0, 2, 3, 6, 17, 21, 24, 25, 26, 27, 30, 31, 255)
VALUES = (
    *("nan", "-1", "0", "1e308", "1e200", "", "\u0663\u0660", "1,5", "9" * 50, "9" * 5000, "0x10", "inf"),
    *("100", "\x1b[31m\x07", "=1+1", "-8", "30.5", "\u202e", "256.0", "30", "-14:00:00", "99:99:99"),
)
KEYS = (
    *("Sample Rate", "Start Date", "Stop Date", "Acceleration Min", "Acceleration Max", "Serial Number"),
    *("Device Type", "Firmware", "TimeZone", "Last Sample Time", "Battery Voltage", "Acceleration Scale"),
)
SCALE_KEY = "Acceleration Scale"
METADATA = (
    *(b"[" * 3000, b'{"MetadataType":"LocalTimeLog","UsedUtc":true}', b'{"UsedUtc":NaN}', b"\xff\xfe"),
    *(b'{"a":1e999}', b"1" * 4000, b'{"MetadataType":"\\ud800"}'),
)
COLUMNS = (b"Accelerometer X", b"Accelerometer Y", b"Accelerometer Z", b"Temperature", b"Gyroscope X")


@cache
def counts(rows: int = 480) -> np.ndarray:
    return np.random.RandomState(11).randint(-500, 500, (rows, 3)).astype(np.int16)


@cache
def recordings() -> tuple[tuple[bytes, ...], ...]:
    told = [make_gt3x.parameters({(1, 10): RATE}), make_gt3x.battery(START_S)]
    kinds = (ACTIVITY2, ACTIVITY, ACTIVITY3)
    return tuple((*told, *make_gt3x.seconds(counts(), RATE, kind)) for kind in kinds)


def fields(one: bytes) -> tuple[int, int, bytes]:
    return one[1], int.from_bytes(one[2:6], "little"), one[8:-1]


def again(one: bytes, **new: int | bytes) -> bytes:
    """A record with other fields, and a checksum that is right again."""
    kind, second, payload = fields(one)
    told = {"kind": kind, "second": second, "payload": payload} | new
    return record(told["kind"], told["second"] % (1 << 32), told["payload"][:LONGEST])


def jump(log: Records, random: Random) -> None:
    where, by = stretch(log, random, (1, 3, 1000)), random.choice(JUMPS_S)
    log[where] = [again(one, second=fields(one)[1] + by) for one in log[where]]


def second(log: Records, random: Random) -> None:
    where, when = stretch(log, random, (1, 2)), random.choice([0, 1, (1 << 32) - 1, random.getrandbits(32)])
    log[where] = [again(one, second=when) for one in log[where]]


def longer(log: Records, random: Random) -> None:
    where, factor = stretch(log, random, (1, 3, 1000)), random.choice([1, 2, 3])
    cut = random.choice([None, -1, -9, -6, 6, 18, 1, 0])
    log[where] = [again(one, payload=(fields(one)[2] * factor)[:cut]) for one in log[where]]


def kind(log: Records, random: Random) -> None:
    where, new = stretch(log, random, (1, 1, 3)), random.choice(KINDS)
    log[where] = [again(one, kind=new) for one in log[where]]


def empty(log: Records, random: Random) -> None:
    """Records without content, or with far too much."""
    at = random.randrange(len(log))
    size = random.choice([0, 0, 1, 4096, 65_535])
    payload = bytes(random.choices(range(31, 256), k=size))
    log.insert(at, record(random.choice(KINDS), fields(log[at])[1], payload))


def sleep(log: Records, random: Random) -> None:
    """The device sleeps, and may or may not say that it wakes."""
    at, length = random.randrange(2, max(3, len(log))), random.choice([1, 5, 60, 600])
    if at >= len(log):
        return
    when = fields(log[at])[1]
    new = [make_gt3x.event(when, make_gt3x.ASLEEP)]
    new += [make_gt3x.battery((when + k) % (1 << 32)) for k in range(0, length, 60)]
    if random.random() < 0.7:
        new.append(make_gt3x.event((when + length) % (1 << 32), make_gt3x.AWAKE))
    if random.random() < 0.7:
        log[at:] = [again(one, second=fields(one)[1] + length) for one in log[at:]]
    log[at:at] = new


def schema(log: Records, random: Random) -> None:
    """A sensor of its own kind, as sound as dice make it."""
    columns = b"".join(
        struct.pack(
            *("<BBBI16s", random.randrange(4), random.choice([0, 16, 32, 255])),
            *(random.choice([16, 8, 0, 255]), random.getrandbits(32), random.choice(COLUMNS)),
        )
        for _ in range(random.randrange(8))
    )
    head = struct.pack("<HHH", random.choice([0, 1]), len(columns) // 23, random.choice([0, 100, 65_535]))
    data = random.randbytes(random.choice([2, 20, 200, 2002]))
    log[1:1] = [record(24, START_S, head + columns), record(25, START_S, data)]


def told(log: Records, random: Random) -> None:
    keys = [(random.choice([0, 1]), random.choice([10, 12, 55, 57, 58, 44, 0])) for _ in range(4)]
    log.insert(1, make_gt3x.parameters({key: random.getrandbits(32) for key in keys}))
    log.insert(1, record(6, START_S, random.choice(METADATA)))


def junk(log: Records, random: Random) -> None:
    new = bytes(random.choices([value for value in range(256) if value != SEPARATOR], k=300))
    log.insert(random.randrange(len(log)), random.choice([new, bytes(random.choice([1, 7, 9, 300]))]))


def bits(log: Records, random: Random) -> None:
    at = random.randrange(len(log))
    frame, payload, end = log[at][:8], log[at][8:-1], log[at][-1:]
    log[at] = frame + (flip(payload, random) if payload else payload) + end


def noise(log: Records, random: Random) -> None:
    new = random.choice([b"\x1e" * 500, b"\x1e\x00" * 200, random.randbytes(300)])
    log.insert(random.randrange(len(log)), new)


WHOLE: tuple[Change, ...] = (*ORDER, jump, jump, second, longer, kind, empty, sleep, told)
"""All that comes of these are whole records again."""

BROKEN: tuple[Change, ...] = (junk, bits, noise, schema)


def info_of(random: Random) -> tuple[bytes | None, str]:
    """The info.txt, perhaps damaged, and what was done."""
    text = make_gt3x.info(RATE)
    if random.random() < 0.7:
        return text.encode(), ""
    key, value = random.choice(KEYS), random.choice(VALUES)
    text = re.sub(rf"(?m)^{key}:[^\r\n]*", lambda _: f"{key}: {value}", text)
    form = random.randrange(9)
    if form == 0:
        text = re.sub(rf"(?m)^{key}:[^\r\n]*\r\n", "", text)
    if form == 1:
        text *= random.choice([2, 300])
    if form == 2:
        text = text.replace("\r\n", "\n")
    if form == 3:
        return None, "no info"
    data = text.encode("utf-16") if form == 4 else random.randbytes(300) if form == 5 else text.encode()
    return data, f"info {key}"


def maker(random: Random) -> dict[str, object]:
    values: dict[str, object] = {"isCalibrated": False, "calibrationMethod": 2}
    values |= {f"offset{axis}_{RATE}": random.randrange(-50, 50) for axis in "XYZ"}
    values |= {f"sensitivity{axis * 2}_{RATE}": random.randrange(24_000, 27_000) for axis in "XYZ"}
    return values | {f"sensitivity{pair}_{RATE}": random.randrange(-500, 500) for pair in ("XY", "XZ", "YZ")}


def beside(random: Random) -> tuple[dict[str, bytes], str, dict[str, object] | None]:
    """calibration.json and the like, what was done to them, and what is to be applied."""
    if random.random() < 0.7:
        return {}, "", None
    values = maker(random)
    heat = {"isCalibrated": random.random() < 0.3, "calibrationMethod": 1, "tempLow": 20, "tempHigh": 40}
    heat |= {"adxlTempLow": 1500, "adxlTempHigh": random.choice([1900, 1500, "x"])}
    parts = {"temperature_calibration.json": json.dumps(heat).encode()}
    if random.random() < 0.5:
        return parts | {"calibration.json": json.dumps(values).encode()}, "maker", values
    values |= {
        random.choice(list(values)): random.choice([None, [], {}, "1e400", -1, 1 << 70, 1e300, True, ""])
    }
    data = json.dumps(values).encode()
    data = random.choice(
        [data, blind(data, random), data[: random.randrange(len(data))], random.choice(METADATA)]
    )
    return parts | {"calibration.json": data}, "broken maker", None


def calibrated(rows: np.ndarray, values: dict[str, object]) -> np.ndarray:
    """Rows that counts / 256 stand for, behind a calibration.json."""
    said = {name.split("_")[0]: float(str(value)) / 100 for name, value in values.items() if "_" in name}
    offset = 100 * np.array([said[f"offset{axis}"] for axis in "XYZ"])
    matrix = np.array(
        [
            [
                1 / said[f"sensitivity{a + b}"]
                if a == b
                else 1 / (250 + said[f"sensitivity{min(a, b) + max(a, b)}"]) - 0.004
                for b in "XYZ"
            ]
            for a in "XYZ"
        ]
    )
    return np.clip((rows * 256 - offset) @ matrix, -LARGEST_G, LARGEST_G)


def zipped(log: bytes, info: bytes | None, more: dict[str, bytes], random: Random) -> bytes:
    """All in a zip file, perhaps with more, or twice."""
    parts = [("log.bin", log)] + ([] if info is None else [("info.txt", info)]) + [*more.items()]
    random.shuffle(parts)
    if random.random() < 0.05:
        parts += random.choice([[("../x", b"y")], [("log.bin", log[:100])], [("lux.bin", b"")], parts])
    buffer = io.BytesIO()
    method = random.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(buffer, "w", method) as archive:
        for name, data in parts:
            member = zipfile.ZipInfo(name)
            member.compress_type = archive.compression
            with archive.open(member, "w") as file:
                file.write(data)
    return buffer.getvalue()


def damaged_zip(data: bytes, random: Random) -> bytes:
    directory, ending = data.rfind(b"PK\x01\x02"), data.rfind(b"PK\x05\x06")
    new = bytearray(data)
    form = random.randrange(8)
    if form == 0:
        return data[: random.choice([directory, ending, random.randrange(len(data))])]
    if form == 1:
        new[random.randrange(directory, len(data))] = random.getrandbits(8)
    if form == 2:
        new[random.randrange(60)] = random.getrandbits(8)
    if form == 3:
        return random.randbytes(random.choice([1, 100, 5000])) + data
    if form == 4:
        return data + random.randbytes(random.choice([1, 100, 70_000]))
    if form == 5:
        struct.pack_into("<I", new, ending + 16, random.choice([0, (1 << 32) - 1, random.getrandbits(20)]))
    if form == 6:
        struct.pack_into("<I", new, directory + random.choice([16, 20, 24, 42]), random.getrandbits(32))
    return bytes(new) if form < 7 else data + data


def old(random: Random) -> Mutant:
    """A recording of the older kind, of packed samples without records."""
    data = make_gt3x.packed(counts())
    info = make_gt3x.old_info(RATE).encode()
    what = random.choice(["whole", "blind", "cut"])
    if what == "blind":
        data = blind(data, random)
    if what == "cut":
        data = data[: random.randrange(len(data))]
    rows = counts()[: 2 * len(data) // PAIR_BYTES] / SIX_G
    held = None if what == "blind" else Truth(rows, rows)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, part in (("activity.bin", data), ("lux.bin", b""), ("info.txt", info)):
            archive.writestr(zipfile.ZipInfo(name), part)
    if random.random() < 0.5:
        return Mutant(buffer.getvalue(), f"old {what}", held)
    return Mutant(damaged_zip(buffer.getvalue(), random), f"old {what} zip", held and possible(held))


def mutant(random: Random) -> Mutant:
    if random.random() < 0.1:
        return old(random)
    log = list(random.choice(recordings()))
    what = changed(log, random, WHOLE)
    if random.random() < 0.3 and len(log) > 1:
        what = f"{what} {changed(log, random, BROKEN, 2)}"
    info, how = info_of(random)
    joined = b"".join(log)
    known = not how and "noise" not in what and "schema" not in what
    if random.random() < 0.08:
        joined, what, known = joined[: random.randrange(len(joined))], f"{what} cut", False
    if random.random() < 0.1:
        joined, what, known = blind(joined, random), f"{what} blind", False
    more, done, applied = beside(random)
    data, what = zipped(joined, info, more, random), f"{what} {done}"
    once = data.count(b"PK\x01\x02") == 2 + len(more)
    held = truth(joined, applied) if known and once and done != "broken maker" else None
    if random.random() < 0.12:
        # the maker's calibration may be what is damaged
        held = possible(held) if held is not None and applied is None else None
        data, what = damaged_zip(data, random), f"{what} zip"
    options = ReadOptions(sensor="imu" if "schema" in what and random.random() < 0.5 else None)
    return Mutant(data, f"{what} {how}", held, options)


def possible(held: Truth) -> Truth:
    """What a damaged zip file may hold of its parts: nothing for sure, but nothing else."""
    return Truth(np.empty((0, 3)), held.possible)


def truth(log: bytes, applied: dict[str, object] | None) -> Truth | None:
    """Rows of all whole records of a log in which nothing but whole records looks like one.

    A record of a kind that none is given was found in noise by chance: nobody can tell where the next one
    begins.
    """
    place, parts, left_over = 0, [], 0
    while place < len(log):
        size = record_bytes(log, place)
        if size and log[place + 1] not in KINDS:
            return None
        if size:
            parts.append(record_rows(log[place : place + size]))
        else:
            left_over += log[place] != 0
        place += size or 1
    rows = together(parts) if applied is None else calibrated(together(parts), applied)
    return Truth(rows, rows, left_over)


def record_bytes(log: bytes, place: int) -> int:
    """The length of the whole record that begins at a place, 0 for none."""
    if log[place] != SEPARATOR or place + FRAME > len(log):
        return 0
    size = FRAME + int.from_bytes(log[place + 6 : place + 8], "little")
    one = np.frombuffer(log, np.uint8, min(size, len(log) - place), place)
    return size if len(one) == size and np.bitwise_xor.reduce(one) == 0xFF else 0


def record_rows(one: bytes) -> np.ndarray:
    kind, _, payload = fields(one)
    if kind == ACTIVITY2:
        return np.frombuffer(payload, "<i2", len(payload) // 6 * 3).reshape(-1, 3) / 256
    if kind not in (ACTIVITY, ACTIVITY3):
        return np.empty((0, 3))
    digits = payload.hex()
    samples = [
        [int(digits[at : at + 3], 16) for at in (k, k + 3, k + 6)] for k in range(0, len(digits) - 8, 9)
    ]
    values = (np.array(samples, int).reshape(-1, 3) ^ 0x800) - 0x800
    return values[:, [1, 0, 2] if kind == ACTIVITY else [0, 1, 2]] / 256

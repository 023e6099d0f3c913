"""Damaged text tables: cells, times, lines, separators, quotes, units, headers, line ends, encodings."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth

SUFFIX = ".csv"
ROWS = 400
RATE = 25
START = datetime(2024, 3, 4, tzinfo=UTC)
START_S = 1_709_510_400
LARGEST_CELL = 1e9
LARGEST_G = 4.0
"""Beyond it, a value may be taken for clipped or impossible."""

CELLS = (
    *(
        "",
        "nan",
        "NaN",
        "inf",
        "-inf",
        "1e400",
        "-1e400",
        "1e-400",
        "0x1F",
        "1_000",
        "\u0661\u0662",
        "+",
        "-",
    ),
    *("--1", '"1.0"', "' 1'", "\x1b[31m", "\x00", "=1+1", "true", "None", "1e5", "9" * 20, "1e308", "-1e308"),
    *("2024-03-04", "12:00", "NA", "null", " 1 ", "1 2", "\u00e9", "\u202e", "\uff11", "0" * 400, "1" * 400),
    *("9" * 3000 + "x", "1" * 300 + "e" * 300, "127", "-128", "0.5.5", "1e", "e1", ".", "1.", ".5", "\ufeff"),
)
TIMES = (
    *("2024-03-04 00:00:00", "2024-02-30 00:00:00.000000", "1970-01-01 00:00:00.000000", "nan", "", "1e18"),
    *("2262-04-12 00:00:00.000000", "2300-01-01 00:00:00.000000", "1677-01-01 00:00:00.000000", "-1e18"),
    *("9999-12-31 23:59:59.999999", "0001-01-01 00:00:00.000000", "0001-01-01T00:00:00+14:00", "9e11"),
    *("2024-03-31 02:30:00.000000", "2024-03-04T00:00:00Z", "2024-03-04 00:00:00+25:00", "1e300", "0", "-1"),
    *("12:00:00 AM", "13:00:00 AM", "0:00:00 PM", "3/4/2024", "2024-02-30", "04.03.24", "\u0661:00:00 PM"),
    *("2024-03-04 25:00:00", "1709510400", "1709510400000", "9999-12-31T23:59:59-14:00", "10000-01-01"),
)
LINES = (
    *("", "#comment", "time,x,y,z", ",,,", ",", '"', "a,b,c,d", "\x00\x00\x00", "\x1b]0;x\x07", "-----"),
    *("NaN,NaN,NaN,NaN", "\ufeff", "1,2,3,4,5", "1,2,3", "x" * 3000, " ,  , ,", "z (" + " " * 3000 + "!"),
)
HEADERS = (
    *("", "time,x,y,z,w", "x,y,z", "time,y,x,z", "time,x,x,x", "time,X (g),Y (g),Z (g)", "time,x [m/s2],y,z"),
    *("time,x [mg],y [g],z [mg]", "t,a,b,c", "time,acc_x,acc_y,acc_z,gyr_x", "\x1b[31mtime,x\x07,y,z"),
    *("=cmd(),x,y,z", "time," + "x" * 3000 + ",y,z", "time,x,y,z,", "\u0432\u0440\u0435\u043c\u044f,x,y,z"),
    *(
        "time (ms),x,y,z",
        "unix,x,y,z",
        '"time","x","y","z"',
        "time,x(,y(,z(",
        "time,x,y,z (" + " " * 3000 + "!",
    ),
    *("time;x;y;z", "time,x [foo],y [foo],z [foo]", "timestamp_ms,x,y,z", "time,x,y,z,temperature [C]"),
)
LONG_JUMPS_S = (1, -1, 60, -60, 3600, -3600, 86_400 * 30, -86_400 * 300, 86_400 * 365_000)
NUMBER = re.compile(r"[+-]?[0-9]{1,3}\.[0-9]{1,9}")
ANY_NUMBER = re.compile(r"\s*[+-]?([0-9]+(?:\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?\s*")
"""No digit can match in two places: a cell of 3000 digits and a letter would take 4.5 million attempts."""

TIME = re.compile(r"2024-03-04 00:\d\d:\d\d\.\d{6}")
Lines = list[str]
Change = Callable[[Lines, Random], None]


@cache
def values() -> tuple[tuple[float, float, float], ...]:
    counts = np.random.RandomState(11).randint(-300, 300, (ROWS, 3)) / 256
    return tuple(map(tuple, counts.tolist()))


def text_of(row: tuple[float, ...], factor: float = 1.0, sign: str = ",") -> str:
    return sign.join(f"{value * factor:.8f}" for value in row)


def moment(row: int, form: str = "%Y-%m-%d %H:%M:%S.%f") -> str:
    return (START + timedelta(microseconds=row * 1_000_000 // RATE)).strftime(form)


@cache
def plain() -> tuple[str, ...]:
    """Times and g: what the truth is known of."""
    return ("time,x,y,z", *(f"{moment(k)},{text_of(row)}" for k, row in enumerate(values())))


def epoch_s() -> Lines:
    return ["t,x,y,z", *(f"{START_S + k / RATE:.2f},{text_of(row)}" for k, row in enumerate(values()))]


def epoch_ms() -> Lines:
    head = "timestamp_ms,acc_x,acc_y,acc_z,temp"
    return [
        head,
        *(f"{START_S * 1000 + k * 40},{text_of(row)},25.{k % 10}" for k, row in enumerate(values())),
    ]


def semicolons() -> Lines:
    return [line.replace(",", ";") for line in plain()]


def decimal_commas() -> Lines:
    body = (f"{moment(k)};{text_of(row, sign=';').replace('.', ',')}" for k, row in enumerate(values()))
    return ["time;x;y;z", *body]


def tabs() -> Lines:
    return [line.replace(",", "\t") for line in plain()]


def blanks() -> Lines:
    return ["x y z", *(text_of(row, sign=" ") for row in values())]


def days_first() -> Lines:
    body = (f"{moment(k, '24/%m/%Y %H:%M:%S.%f')},{text_of(row)}" for k, row in enumerate(values()))
    return ["time,x,y,z", *body]


def two_columns() -> Lines:
    return ["date,time,x,y,z", *(line.replace(" ", ",", 1) for line in plain()[1:])]


def mornings() -> Lines:
    body = (f"{moment(k, '%m/%d/%Y,%I:%M:%S.%f %p')},{text_of(row)}" for k, row in enumerate(values()))
    return ["Date,Time,x,y,z", *body]


def afternoons() -> Lines:
    body = (f"{moment(k, '%Y-%m-%d 0%M:%S.%f PM')},{text_of(row)}" for k, row in enumerate(values()))
    return ["time,x,y,z", *body]


def zoned() -> Lines:
    return ["time,x,y,z", *(f"{moment(k)}Z,{text_of(row)}" for k, row in enumerate(values()))]


def milli_g() -> Lines:
    head = "time,x [mg],y [mg],z [mg]"
    return [head, *(f"{moment(k)},{text_of(row, 1000)}" for k, row in enumerate(values()))]


def metres() -> Lines:
    return ["time,x,y,z", *(f"{moment(k)},{text_of(row, 9.80665)}" for k, row in enumerate(values()))]


def actigraph() -> Lines:
    head = (
        "------------ Data File Created By ActiGraph Link ActiLife v6.13.4 Firmware v1.7.2 "
        "date format M/d/yyyy at 25 Hz  Filter Normal -----------"
    )
    about = ["Serial Number: TAS1D48140206", "Start Time 00:00:00", "Start Date 3/4/2024"]
    about += ["Epoch Period (hh:mm:ss) 00:00:00", "Download Time 00:00:00", "Download Date 3/5/2024"]
    about += ["Current Memory Address: 0", "Current Battery Voltage: 4.21     Mode = 12", "-" * 50]
    return [head, *about, "Accelerometer X,Accelerometer Y,Accelerometer Z", *map(text_of, values())]


def sensor_logger() -> Lines:
    body = (
        f"{(START_S * 1000 + k * 40) * 1_000_000},{k / RATE:.6f},{text_of(row[::-1], 9.80665)}"
        for k, row in enumerate(values())
    )
    return ["time,seconds_elapsed,z,y,x", *body]


def phyphox() -> Lines:
    names = ["Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz")]
    body = (f"{k / RATE:.9E},{text_of(row, 9.80665)}" for k, row in enumerate(values()))
    return [",".join(f'"{name}"' for name in names), *body]


def metawear() -> Lines:
    head = "epoc (ms),timestamp (+0100),elapsed (s),x-axis (g),y-axis (g),z-axis (g)"
    body = (
        f"{START_S * 1000 + k * 40},{moment(k, '%Y-%m-%dT%H.%M.%S.%f')},{k / RATE},{text_of(row)}"
        for k, row in enumerate(values())
    )
    return [head, *body]


def activpal() -> Lines:
    body = (
        f"{45_355 + k / RATE / 86_400:.12f};{k};{';'.join(str(round(127 + 63 * value)) for value in row)}"
        for k, row in enumerate(values())
    )
    return ["sep=;", "Time;Index;X;Y;Z", *body]


def counted(form: str, unit_ms: float, bits: int) -> Lines:
    """A counter that wraps."""
    ticks = (round((k * 40 + 60_000) / unit_ms) % (1 << bits) for k in range(ROWS))
    return [f"{form},x,y,z", *(f"{t},{text_of(row)}" for t, row in zip(ticks, values(), strict=True))]


def wrapping_ms() -> Lines:
    return counted("time_ms", 1, 16)


def wrapping_us() -> Lines:
    return counted("time_us", 0.001, 25)


def staying_date() -> Lines:
    body = (f"2024-03-04,{moment(k + 25 * 86_396, '%H:%M:%S.%f')}" for k in range(ROWS))
    return ["date,time,x,y,z", *(f"{t},{text_of(row)}" for t, row in zip(body, values(), strict=True))]


def half_days() -> Lines:
    body = (moment(k + 25 * 43_196, "%Y-%m-%d,%I:%M:%S.%f") for k in range(ROWS))
    return ["date,time,x,y,z", *(f"{t},{text_of(row)}" for t, row in zip(body, values(), strict=True))]


def month_names() -> Lines:
    form = "%d-%b-%Y %H:%M:%S.%f"
    return ["time,x,y,z", *(f"{moment(k, form)},{text_of(row)}" for k, row in enumerate(values()))]


def biobank() -> Lines:
    form = "%Y-%m-%d %H:%M:%S.%f+0000 [Europe/London]"
    return ["time,x,y,z", *(f"{moment(k, form)},{text_of(row)}" for k, row in enumerate(values()))]


def basic() -> Lines:
    form = "%Y%m%dT%H%M%S.%f"
    return ["time,x,y,z", *(f"{moment(k, form)},{text_of(row)}" for k, row in enumerate(values()))]


def two_sensors() -> Lines:
    body = (f"{moment(k // 2)},{text_of(row)},{'LR'[k % 2]}" for k, row in enumerate(values()))
    return ["time,x,y,z,sensor", *body]


def mostly_empty() -> Lines:
    body = (f"{moment(k)},{text_of(row) if k % 5 > 2 else 'NaN,,NA'}" for k, row in enumerate(values()))
    return ["time,x,y,z", *body]


def unsigned() -> Lines:
    body = (
        f"{moment(k)},{','.join(str(round(512 + 100 * v)) for v in row)}" for k, row in enumerate(values())
    )
    return ["time,x,y,z", *body]


def warm() -> Lines:
    body = (f"{moment(k)},{text_of(row)},{77 + k % 9 / 10}" for k, row in enumerate(values()))
    return ["time,x,y,z,Temperature_degF", *body]


OTHERS = (
    *(epoch_s, epoch_ms, semicolons, decimal_commas, tabs, blanks, days_first, zoned, milli_g, metres),
    *(actigraph, two_columns, mornings, mornings, afternoons),
    *(sensor_logger, phyphox, metawear, activpal),
    *(wrapping_ms, wrapping_us, staying_date, half_days, month_names, biobank, basic, two_sensors),
    *(mostly_empty, unsigned, warm),
)


def separator(lines: Lines) -> str:
    line = lines[min(20, len(lines) - 1)]
    return max(",;\t ", key=line.count)


def set_cell(lines: Lines, at: int, column: int, text: str) -> None:
    sign = separator(lines)
    cells = lines[at].split(sign)
    cells[column % len(cells)] = text
    lines[at] = sign.join(cells)


def some(lines: Lines, random: Random) -> slice:
    at = random.randrange(1, len(lines))
    return slice(at, at + random.choice([1, 1, 10, 100]))


def cell(lines: Lines, random: Random) -> None:
    for _ in range(random.choice([1, 1, 1, 3, 50])):
        set_cell(lines, random.randrange(1, len(lines)), random.randrange(4), random.choice(CELLS))


def when(lines: Lines, random: Random) -> None:
    for _ in range(random.choice([1, 1, 3])):
        set_cell(lines, random.randrange(1, len(lines)), 0, random.choice(TIMES))


def jump(lines: Lines, random: Random) -> None:
    where, by = some(lines, random), timedelta(seconds=random.choice(LONG_JUMPS_S))
    for at in range(where.start, min(len(lines), where.stop if random.random() < 0.5 else len(lines))):
        try:
            time = datetime.fromisoformat(lines[at].split(",")[0]) + by
        except (ValueError, OverflowError):
            continue
        set_cell(lines, at, 0, time.isoformat(" ", "microseconds"))


def line(lines: Lines, random: Random) -> None:
    at = random.randrange(1, len(lines))
    lines[at:at] = [random.choice(LINES)] * random.choice([1, 1, 3])


def swap(lines: Lines, random: Random) -> None:
    one, two = some(lines, random), some(lines, random)
    lines[one], lines[two] = lines[two], lines[one]


def duplicate(lines: Lines, random: Random) -> None:
    at = random.randrange(1, len(lines))
    lines[at:at] = lines[some(lines, random)]


def delete(lines: Lines, random: Random) -> None:
    del lines[some(lines, random)]


def reverse(lines: Lines, random: Random) -> None:
    where = some(lines, random)
    lines[where] = lines[where][::-1]


def mixed(lines: Lines, random: Random) -> None:
    sign, where = separator(lines), some(lines, random)
    lines[where] = [row.replace(sign, random.choice(";\t|")) for row in lines[where]]


ROWS_ONLY: tuple[Change, ...] = (
    *(cell, cell, when, when, jump, jump, line, swap, swap, duplicate, duplicate, delete, delete, reverse),
    mixed,
)
"""The truth of what these leave can be told line by line."""


def shuffled(lines: Lines, random: Random) -> None:
    body = lines[1:]
    random.shuffle(body)
    lines[1:] = body


def headers_again(lines: Lines, random: Random) -> None:
    step = random.choice([50, 300])
    for at in range(step, len(lines), step):
        lines.insert(at, lines[0])


def header(lines: Lines, random: Random) -> None:
    lines[0] = random.choice(HEADERS)


def no_header(lines: Lines, random: Random) -> None:
    del lines[: random.choice([1, 1, 5, 11])]


def trailing(lines: Lines, random: Random) -> None:
    end = separator(lines) + random.choice(["", "0", "abc"])
    lines[:] = [row + end for row in lines]


def quoted(lines: Lines, random: Random) -> None:
    sign, first = separator(lines), random.choice([0, len(lines) // 2])
    lines[first:] = [sign.join(f'"{part}"' for part in row.split(sign)) for row in lines[first:]]


def open_quote(lines: Lines, random: Random) -> None:
    at = random.randrange(len(lines))
    lines[at] = lines[at].replace("0", '"', 1)


def column(lines: Lines, random: Random) -> None:
    text, place = random.choice(CELLS + TIMES), random.randrange(4)
    for at in range(1, len(lines)):
        set_cell(lines, at, place, text)


def scaled(lines: Lines, random: Random) -> None:
    where, sign, factor = (
        some(lines, random),
        separator(lines),
        random.choice([9.80665, 1000.0, 0.0, -1.0, 1e9]),
    )
    for at in range(where.start, min(len(lines), where.stop)):
        first, *rest = lines[at].split(sign)
        if all(map(NUMBER.fullmatch, rest)):
            lines[at] = sign.join([first, *(f"{float(part) * factor:.6f}" for part in rest)])


ALL: tuple[Change, ...] = (
    *(*ROWS_ONLY, shuffled, headers_again, header, header, no_header, trailing, quoted, open_quote, column),
    scaled,
)


def encoded(text: str, random: Random) -> bytes:
    """The text as one or another program writes it, or something that cuts it short."""
    plain_bytes = text.encode("utf-8", "surrogatepass")
    at = random.randrange(len(plain_bytes))
    forms: tuple[Callable[[], bytes], ...] = (
        lambda: text.encode("utf-16", "surrogatepass"),
        lambda: b"\xef\xbb\xbf" + plain_bytes,
        lambda: plain_bytes.replace(b"\n", b"\r\n"),
        lambda: plain_bytes.replace(b"\n", b"\r"),
        lambda: plain_bytes.rstrip(b"\n"),
        lambda: plain_bytes[:at],
        lambda: text.encode("utf-32", "surrogatepass"),
        lambda: text.encode(random.choice(["utf-16-le", "utf-16-be", "utf-32-le"]), "surrogatepass"),
        lambda: plain_bytes + random.choice(["End of file", "Total;400;rows", "# 400 rows,,,"]).encode(),
        lambda: plain_bytes[:at] + bytes(random.choice([1, 512, 70_000])) + plain_bytes[at:],
        lambda: plain_bytes[:at] + random.randbytes(random.choice([1, 5, 300])) + plain_bytes[at:],
        lambda: plain_bytes + bytes(random.choice([1, 4096, 100_000])),
        lambda: text.encode("latin-1", "replace"),
    )
    return random.choice(forms)()


def mutant(random: Random) -> Mutant:
    if random.random() < 0.4:
        lines = list(plain())
        what = changed(lines, random, ROWS_ONLY)
        data = ("\n".join(lines) + "\n").encode()
        return Mutant(data, f"plain {what}", truth(lines), sound_lines=frozenset(sound_rows()))
    make = random.choice([lambda: list(plain()), *OTHERS])
    lines = make()
    if random.random() < 0.2:
        return Mutant(blind("\n".join(lines).encode(), random), "blind")
    what = changed(lines, random, ALL)
    text = "\n".join(lines) + "\n"
    data = encoded(text, random) if random.random() < 0.4 else text.encode()
    rate = ReadOptions(rate_hz=float(RATE))
    options = rate if make is blanks or random.random() < 0.1 else ReadOptions()
    return Mutant(data, f"{make.__name__} {what}", None, options)


def changed(lines: Lines, random: Random, changes: tuple[Change, ...]) -> str:
    names = []
    for _ in range(random.choice([1, 1, 2, 3])):
        if len(lines) > 30:
            change = random.choice(changes)
            change(lines, random)
            names.append(change.__name__)
    return " ".join(names)


def truth(lines: Lines) -> Truth:
    """Rows of lines below the header: four plain cells are sure, others that hold numbers possible."""
    sure, possible, damaged = [], [], 0
    for line in lines[1:]:
        row, is_sure = sound_rows().get(line) or row_of(line.split(","))
        if is_sure:
            sure.append(row)
        if row is not None:
            possible.append(row)
        damaged += row is None and any(part.strip() for part in line.split(","))
    return Truth(np.array(sure).reshape(-1, 3), np.array(possible).reshape(-1, 3), damaged)


@cache
def sound_rows() -> dict[str, tuple[list[float] | None, bool]]:
    return {line: row_of(line.split(",")) for line in plain()[1:]}


def row_of(cells: list[str]) -> tuple[list[float] | None, bool]:
    """The row that a line may be taken for, None for none; whether it is one beyond doubt."""
    row = [float(part) if ANY_NUMBER.fullmatch(part) else np.nan for part in map(unquoted, cells[1:4])]
    if len(row) != 3 or not np.isfinite(row).all() or np.abs(row).max() >= LARGEST_CELL:
        return None, False
    whole = len(cells) == 4 and TIME.fullmatch(cells[0]) and all(map(NUMBER.fullmatch, cells[1:]))
    return row, bool(whole) and max(map(abs, row)) < LARGEST_G


def unquoted(cell: str) -> str:
    return cell[1:-1] if len(cell) > 2 and cell[0] == cell[-1] == '"' else cell

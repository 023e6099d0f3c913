"""Measure firmware/accelcal.h on an ATmega328P and a Cortex-M3: flash, RAM, time, and whether the bits agree.

`make firmware` runs it; `python -m firmware.measure -O2` compiles otherwise than with -Os. It needs Debian's
gcc-avr, avr-libc and simavr, and gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm; a processor
whose tools are absent is left out.

simavr counts the cycles of an ATmega328P. QEMU knows no cycles: it tells which instructions of a Cortex-M3
ran, and ARM's table of their cycles (DDI 0337, table 3-1, without wait states) gives the least and the
most that these take.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
COMPILED = ("-std=gnu99", "-Wall", "-Wextra", "-Werror", f"-I{HERE}")
LENGTH = 125
"""Samples in a window of case.h."""
SECTIONS = ("sample", "window", "points", "fit")
OPERATIONS = 90_150
"""Additions, and multiplications, of F for 18 points and 50 iterations."""

_CONDITION = "(?:eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"
_BRANCH = re.compile(rf"(?:b|bl|bx|blx){_CONDITION}|cbn?z")
_MANY = re.compile(rf"(?:push|pop|ldm|stm|ldrd|strd)\w*?{_CONDITION}")
_FIXED = {"umull": (3, 5), "smull": (3, 5), "umlal": (4, 7), "smlal": (4, 7), "mla": (2, 2), "mls": (2, 2)}
_DIVISIONS = ("udiv", "sdiv")
_REFILL = (1, 3)


@dataclass(frozen=True, slots=True)
class Measured:
    """What one processor needs.

    Attributes:
        flash: bytes of code and constants that a program grows by.
        held, points, stack: bytes of the struct, of 18 points and the parameters, and of the deepest stack.
        cycles: least and most of each of SECTIONS; the fit's of the whole fit, others of the longest one.
        instructions: of the fit; None if cycles were counted.
        parameters: what the fit found.
    """

    name: str
    mhz: int
    flash: int
    held: int
    points: int
    stack: int
    cycles: dict[str, tuple[int, int]]
    instructions: int | None
    parameters: tuple[int, ...]


def run(*words: str | Path) -> str:
    """What a command prints; its error is the error of this one."""
    done = subprocess.run(
        list(map(str, words)), check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    text = re.sub(r"\x1b\[\d*m", "", done.stdout.decode(errors="replace"))
    if done.returncode:
        sys.exit(f"{words[0]} failed:\n{text}")
    return text


def case() -> list[list[int]]:
    """Raw means of the windows of case.h."""
    rows = re.findall(r"\{(-?\d+), (-?\d+), (-?\d+)\}", (HERE / "case.h").read_text())
    return [[int(value) for value in row] for row in rows]


def expected() -> tuple[int, ...]:
    """The package's parameters of the same windows."""
    import numpy as np

    from accelcal_cli.collect.subsets import PaperCollector
    from accelcal_cli.core.points import MODELS, Windows
    from accelcal_cli.core.settings import PAPER
    from accelcal_cli.optimize import fixed32

    sums = LENGTH * np.array(case(), np.int64)
    samples = np.full(len(sums), LENGTH, np.int64)
    collector = PaperCollector(256.0, PAPER)
    collector.add(Windows(samples, np.cumsum(samples) - samples, sums, np.zeros_like(sums)))
    return fixed32.fit(collector.fit.points(), MODELS["9"], fixed32.PAPER).parameters[:9]


def flash(folder: Path, compiler: list[str], size: str) -> int:
    """Bytes that example.c has more than a program that does nothing."""
    empty = folder / "empty.c"
    empty.write_text("int main(void) { for (;;) {} }\n")
    found = []
    for source in (empty, HERE / "example.c"):
        program = folder / f"{source.stem}.elf"
        run(*compiler, source, "-o", program)
        text, data, *_ = run(size, program).splitlines()[1].split()
        found.append(int(text) + int(data))
    return found[1] - found[0]


def told(text: str) -> dict[str, list[int]]:
    """What bench.c said, by name."""
    said: dict[str, list[int]] = {}
    for name, value in re.findall(r"([a-z]+)([ -]\d+)", text):
        said.setdefault(name, []).append(int(value))
    if said.get("points") != [18] or said.get("found") != [1]:
        sys.exit(f"bench.c found nothing:\n{text}")
    return said


def atmega328(flags: list[str]) -> Measured:
    """An ATmega328P at 16 MHz: cycles counted by its own timer, in simavr."""
    compiler = ["avr-gcc", "-mmcu=atmega328p", *flags, *COMPILED]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        grown = flash(folder, compiler, "avr-size")
        run(*compiler, HERE / "bench.c", "-o", folder / "bench.elf")
        said = told(run("simavr", "-m", "atmega328p", "-f", "16000000", folder / "bench.elf"))
    cycles = {section: (count, count) for section, count in zip(SECTIONS, said["cycles"], strict=True)}
    return _measured("ATmega328P", 16, grown, said, cycles, None)


def cortex_m3(flags: list[str]) -> Measured:
    """A Cortex-M3 at 80 MHz: instructions that QEMU ran, and ARM's table."""
    compiler = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", *flags, *COMPILED]
    compiler += ["-nostartfiles", "--specs=nosys.specs", "-Wl,-e,main"]
    places = "-Wl,--section-start=.vectors=0,-Ttext=0x100,-Tdata=0x20000000"
    machine = ["qemu-system-arm", "-M", "mps2-an385", "-nographic", "-monitor", "none"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program, trace = folder / "bench.elf", folder / "trace"
        grown = flash(folder, compiler, "arm-none-eabi-size")
        run(*compiler, places, HERE / "bench.c", "-o", program)
        machine += ["-semihosting-config", "enable=on,target=native", "-kernel", str(program)]
        said = told(run(*machine, "-singlestep", "-d", "exec,nochain", "-D", trace))
        table = disassembled(run("arm-none-eabi-objdump", "-d", program))
        names = run("arm-none-eabi-nm", program)
        marks = {mark: int(address, 16) for address, mark in re.findall(r"(?m)^(\w+) T (begin|end)$", names)}
        stretches = list(between(addresses(trace), marks["begin"], marks["end"]))
    costs = [cost(stretch, table) for stretch in stretches]
    *samples, points, fit = costs
    windows = samples[LENGTH - 1 :: LENGTH]
    inside = [one for place, one in enumerate(samples, 1) if place % LENGTH]
    cycles = {"sample": _most(inside), "window": _most(windows), "points": points, "fit": fit}
    return _measured("Cortex-M3", 80, grown, said, cycles, stretches[-1].total())


def _most(costs: list[tuple[int, int]]) -> tuple[int, int]:
    return max(least for least, _ in costs), max(most for _, most in costs)


def _measured(
    name: str,
    mhz: int,
    grown: int,
    said: dict[str, list[int]],
    cycles: dict[str, tuple[int, int]],
    instructions: int | None,
) -> Measured:
    held, stack = said["held"][0], said["stack"][0]
    return Measured(name, mhz, grown, held, 252, stack, cycles, instructions, tuple(said["parameter"]))


def addresses(trace: Path) -> Iterator[int]:
    """Of the instructions that ran, in QEMU's log of blocks of one instruction."""
    with trace.open() as lines:
        for line in lines:
            if line.startswith("Trace"):
                yield int(line.split("/")[1], 16)


def between(executed: Iterable[int], begin: int, end: int) -> Iterator[Counter[tuple[int, int]]]:
    """Pairs of an instruction and the next, counted, from each call of one function to that of the other."""
    inside: Counter[tuple[int, int]] | None = None
    before = -1
    for address in executed:
        if address == end and inside is not None:
            yield inside
            inside = None
        elif inside is not None and before != begin:
            inside[before, address] += 1
        if address == begin:
            inside = Counter()
        before = address


def disassembled(text: str) -> dict[int, tuple[int, str, str]]:
    """Bytes, name and operands of the instruction at each address."""
    lines = re.findall(r"^ +(\w+):\t([\da-f ]+?) *\t([\w.]+)(?:\t([^;@\n]*))?", text, re.MULTILINE)
    return {
        int(address, 16): (len(code.replace(" ", "")) // 2, name.split(".")[0], operands)
        for address, code, name, operands in lines
    }


def cost(pairs: Counter[tuple[int, int]], table: dict[int, tuple[int, str, str]]) -> tuple[int, int]:
    """Least and most cycles of what was executed."""
    least = most = 0
    for (address, after), number in pairs.items():
        length, name, operands = table[address]
        low, high = cycles_of(name, operands)
        if after != address + length:
            low, high = low + _REFILL[0], high + _REFILL[1]
        least, most = least + low * number, most + high * number
    return least, most


def cycles_of(name: str, operands: str) -> tuple[int, int]:
    """Least and most cycles of an instruction, without what a taken branch adds (DDI 0337, table 3-1).

    A load or store takes 2, one less behind another, one more where its address was computed just before; a
    multiplication to 64 bits and a division depend on their operands; IT may be folded into another one.
    """
    if name in _FIXED:
        return _FIXED[name]
    if name in _DIVISIONS:
        return 2, 12
    if re.fullmatch("it[te]*", name):
        return 0, 1
    if _BRANCH.fullmatch(name):
        return 1, 1
    if _MANY.fullmatch(name):
        number = 2 if name.startswith(("ldrd", "strd")) else _registers(operands)
        return 1 + number, 2 + number
    return (1, 3) if name.startswith(("ldr", "str")) else (1, 1)


def _registers(operands: str) -> int:
    """How many a list such as {r0, r4-r7, lr} names."""
    number = 0
    for part in re.findall(r"\{(.*)\}", operands)[0].split(","):
        first, _, last = part.strip().partition("-")
        names = {"sl": 10, "fp": 11, "ip": 12}
        ends = [names.get(one) or int(one.lstrip("r")) for one in (first, last) if last]
        number += ends[1] - ends[0] + 1 if last else 1
    return number


def lines(found: list[Measured]) -> Iterator[str]:
    """A table of what was measured, and the paper's figures."""
    yield "| | " + " | ".join(f"{one.name}, {one.mhz} MHz" for one in found) + " |"
    yield "|---|" + "---:|" * len(found)
    yield _row("flash [bytes]", [str(one.flash) for one in found])
    yield _row("struct accelcal [bytes]", [str(one.held) for one in found])
    yield _row("points and parameters of a fit [bytes]", [str(one.points) for one in found])
    yield _row("deepest stack [bytes]", [str(one.stack) for one in found])
    for section in SECTIONS:
        yield _row(f"{section} [cycles]", [_range(*one.cycles[section]) for one in found])
    yield _row("fit [instructions]", [str(one.instructions or "") for one in found])
    times = [[cycles / one.mhz / 1000 for cycles in one.cycles["fit"]] for one in found]
    yield _row("fit [ms]", [_range(*(round(time, 1) for time in pair)) for pair in times])
    table_1 = {"ATmega328P": 28 + 97, "Cortex-M3": 14 + 14}
    predicted = [OPERATIONS * table_1[one.name] / one.mhz / 1000 for one in found]
    yield _row("F's operations at the cycles of its Table 1 [ms]", [f"{time:.1f}" for time in predicted])


def _row(title: str, cells: list[str]) -> str:
    return f"| {title} | " + " | ".join(cells) + " |"


def _range(least: float, most: float) -> str:
    return f"{least}" if least == most else f"{least} to {most}"


def main() -> None:
    """Measure on the processors that there are tools for; ends with 1 if the bits differ."""
    tools = {atmega328: ("avr-gcc", "simavr"), cortex_m3: ("arm-none-eabi-gcc", "qemu-system-arm")}
    flags, found = sys.argv[1:] or ["-Os"], []
    for measure, needed in tools.items():
        absent = [tool for tool in needed if not shutil.which(tool)]
        if absent:
            print(f"Not measured: {measure.__name__} ({', '.join(absent)} not found)")
        else:
            found.append(measure(flags))
    if not found:
        sys.exit(1)
    print("\n".join(lines(found)))
    wanted = expected()
    for one in found:
        same = one.parameters == wanted
        print(f"{one.name}: {'the bits of the package' if same else f'{one.parameters}, not {wanted}'}")
    sys.exit(any(one.parameters != wanted for one in found))


if __name__ == "__main__":
    main()

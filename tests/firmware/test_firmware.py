"""firmware/accelcal.h, compiled for this machine, against the package: windows, points and coefficients."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import MODELS, PointSet, Role, Windows
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.core.settings import PAPER
from accelcal_cli.optimize import fixed32
from accelcal_cli.pipeline.procedures import make_method
from accelcal_cli.pipeline.survey import StillWindows, open_marked, survey, with_clipping
from firmware import measure
from tests.cli.run import exit_code
from tests.conftest import ROOT
from tests.optimize.oracle import drawn_errors, measured, points, random_directions
from tests.recordings import RATE_HZ, directions, good_raw
from tests.segment.streams import Stream

SAMPLE, UNMEASURED, BREAK = range(3)
UNUSABLE, MOVING = 1, 2
ROLES = {3: Role.IMPLAUSIBLE, 4: Role.NOT_TAKEN, 5: Role.FIT, 6: Role.CONTROL}
"""WindowUses of windows in accelcal.h, and the package's."""

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
SAMPLES = sorted(path.name for path in (ROOT / "sample_data").iterdir() if not path.name.endswith(".json"))

NO_LEAK_SEARCH = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}
"""It fails where processes may not be traced, and nothing is allocated."""

Driver = Callable[..., list[list[str]]]


@dataclass
class Made:
    """What was made of a recording.

    Attributes:
        windows: first sample and role of each still window.
        others: numbers of moving and of unusable windows.
        fit, control: points of the two sets, fixed-point g.
        parameters: nine; None without 18 points, empty if the descent diverged.
    """

    windows: list[tuple[int, int]] = field(default_factory=list)
    others: tuple[int, int] = (0, 0)
    fit: list[list[int]] = field(default_factory=list)
    control: list[list[int]] = field(default_factory=list)
    parameters: list[int] | None = None


def compiled(folder: Path, *flags: str) -> Path | None:
    """The driver, or None if there is no compiler, or it knows not these flags."""
    compiler, program = shutil.which("cc"), folder / "driver"
    if compiler is None:
        return None
    words = [compiler, *FLAGS, *flags, f"-I{ROOT / 'firmware'}", str(Path(__file__).with_name("driver.c"))]
    done = subprocess.run([*words, "-o", str(program)], capture_output=True, text=True, check=False)
    if done.returncode and "-fsanitize" not in " ".join(flags):
        pytest.fail(done.stderr)
    return None if done.returncode else program


def _driver(program: Path | None, what: str) -> Driver:
    if program is None:
        pytest.skip(what)

    def run(data: bytes, *words: object) -> list[list[str]]:
        words = (str(program), *map(str, words))
        done = subprocess.run(words, input=data, capture_output=True, check=False, env=NO_LEAK_SEARCH)
        assert (done.returncode, done.stderr) == (0, b"")
        return [line.split() for line in done.stdout.decode().splitlines()]

    return run


@pytest.fixture(scope="module", params=["16 bits", "32 bits"])
def driver(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Driver:
    """For counts of 16 and of 32 bits."""
    wide = ("-DACCELCAL_WIDE",) if request.param == "32 bits" else ()
    return _driver(compiled(tmp_path_factory.mktemp("cc"), "-O2", *wide), "there is no C compiler (cc)")


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Driver:
    """For counts of 32 bits."""
    program = compiled(tmp_path_factory.mktemp("cc"), "-O2", "-DACCELCAL_WIDE")
    return _driver(program, "there is no C compiler (cc)")


@pytest.fixture(scope="module", params=["16 bits", "32 bits"])
def strict(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Driver:
    """One that ends where C leaves the result undefined."""
    flags = ("-DACCELCAL_WIDE",) if request.param == "32 bits" else ()
    flags += ("-O1", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
    return _driver(compiled(tmp_path_factory.mktemp("cc"), *flags), "cc has no -fsanitize=undefined,address")


def by_the_package(recording: Recording, chunks: Iterable[Chunk]) -> tuple[Made, bytes]:
    """What the package makes of it, and the records for the driver."""
    method, still, records = make_method(recording, PAPER), StillWindows(), []

    def seen() -> Iterable[Chunk]:
        for chunk in chunks:
            records.append(records_of(chunk))
            yield chunk

    survey(seen(), method.segmenter, [method.procedure, still])
    windows: Windows = still.result()
    roles = method.procedure.window_uses(windows).role
    counts, collector = method.segmenter.counts, method.procedure.collector
    made = Made(
        list(zip(windows.first_sample.tolist(), roles.tolist(), strict=True)),
        (counts.moving, counts.filled + counts.clipped + counts.recovered),
        collector.fit.points().xyz.tolist(),
        collector.control.points().xyz.tolist(),
    )
    assert not counts.repeated
    if len(made.fit) == 18:
        made.parameters = fitted(collector.fit.points())
    return made, b"".join(records)


def fitted(held: PointSet) -> list[int]:
    """The package's nine parameters; none if the descent diverges."""
    try:
        return list(fixed32.fit(held, MODELS["9"], fixed32.PAPER).parameters[:9])
    except DivergedError:
        return []


def records_of(chunk: Chunk) -> bytes:
    """The driver's records of a chunk, marked or not; the driver is to mark what is clipped."""
    kinds = np.zeros(len(chunk), np.int32)
    if chunk.validity is not None:
        kinds[np.isin(chunk.validity, (Validity.FILLED, Validity.RECOVERED))] = UNMEASURED
    rows = np.column_stack([kinds, chunk.counts.astype(np.int32)])
    return np.insert(rows, chunk.breaks, [BREAK, 0, 0, 0], axis=0).astype("=i4").tobytes()


def by_the_header(driver: Driver, recording: Recording, records: bytes) -> Made:
    lsb, scale = recording.lsb_per_g, recording.range_g or 0
    assert lsb == int(lsb)
    length = make_method(recording, PAPER).segmenter.length
    said = driver(records, length, int(lsb), int(scale * lsb))
    window_uses = [(int(line[1]), int(line[2])) for line in said if line[0] == "window"]
    numbers = {
        name: [list(map(int, rest)) for key, *rest in said if key == name] for name in ("fit", "control")
    }
    found = [list(map(int, rest)) for name, *rest in said if name == "parameters"]
    return Made(
        [(first, ROLES[fate]) for fate, first in window_uses if fate in ROLES],
        (sum(fate == MOVING for fate, _ in window_uses), sum(fate == UNUSABLE for fate, _ in window_uses)),
        numbers["fit"],
        numbers["control"],
        found[0] if found else [] if ["diverged"] in said else None,
    )


@pytest.mark.parametrize("name", SAMPLES)
def test_every_sample_recording_gives_the_same_bits(
    driver: Driver, name: str, request: pytest.FixtureRequest
) -> None:
    with open_marked(ROOT / "sample_data" / name, ReadOptions()) as reader:
        recording = reader.recording
        if recording.lsb_per_g > 1 << 15 and "16 bits" in request.node.name:
            pytest.skip("its counts have 32 bits")
        made, records = by_the_package(recording, reader.chunks(50_000))
    assert made.windows and made.fit
    assert by_the_header(driver, recording, records) == made


def test_it_finds_the_integers_that_calibrate_writes(driver: Driver, tmp_path: Path) -> None:
    """From the file to the parameters: `--profile paper --integers`."""
    path = good_raw(tmp_path)
    counts = np.fromfile(path, "<i2").reshape(-1, 3)
    words = ("--profile", "paper", "--integers", "--report-only", "-q")
    assert exit_code("calibrate", path, *words) == 0
    written = json.loads((tmp_path / "good.integers.json").read_text())
    rows = np.column_stack([np.zeros(len(counts)), counts]).astype("=i4")
    said = driver(rows.tobytes(), round(5 * RATE_HZ), 256, 2048)
    found = [list(map(int, rest)) for name, *rest in said if name == "fit"]
    assert found == written["points"]
    parameters = [list(map(int, rest)) for name, *rest in said if name == "parameters"]
    assert parameters == [list(written["parameters"].values())[:9]]


def wild(seed: int) -> tuple[Recording, Stream]:
    """Rests and movement, with breaks, samples at the end of the range, and some that were not measured."""
    random = np.random.default_rng(seed)
    lsb = float(random.choice([64, 100, 255, 256, 341, 1000, 1024, 4096]))
    rate, rests = float(random.choice([1.3, 6.25, 12.5, 25])), random.integers(60, 160)
    v = measured(drawn_errors(random), random_directions(random, rests))
    v *= random.choice([1, 0.45, 1.5], (rests, 1), p=[0.8, 0.1, 0.1])
    held = np.repeat(v, random.integers(round(3 * rate), round(25 * rate), rests), axis=0)
    noise = random.choice([0.001, 0.01, 0.03, 0.3], 1 + len(held) // 97, p=[0.6, 0.2, 0.1, 0.1])
    held += np.repeat(noise, 97)[: len(held), None] * random.standard_normal(held.shape)
    held[random.random(len(held)) < 0.001] *= 9
    counts = np.clip(np.rint(held * lsb), -(1 << 15), (1 << 15) - 1).astype(np.int16)
    validity = random.choice(4, len(counts), p=[0.998, 0.001, 0, 0.001]).astype(np.uint8)
    breaks = tuple(sorted(set(random.integers(1, len(counts), random.integers(0, 9)).tolist())))
    range_g = random.choice([None, 2.0, 8.0])
    recording = Recording(Path("wild"), "raw", rate, lsb, 0, range_g=range_g)
    return recording, Stream(counts, breaks, validity=validity if seed % 3 else None)


def check_wild(driver: Driver, seed: int) -> None:
    recording, stream = wild(seed)
    chunks = [with_clipping(chunk, recording) for chunk in stream.chunks([len(stream.counts) // 3])]
    made, records = by_the_package(recording, chunks)
    assert by_the_header(driver, recording, records) == made


@pytest.mark.parametrize("seed", range(20))
def test_random_recordings_give_the_same_bits(driver: Driver, seed: int) -> None:
    check_wild(driver, seed)


@pytest.mark.parametrize("seed", range(8))
def test_borders_are_the_same_to_a_count(driver: Driver, seed: int) -> None:
    """Means at the ends of the intervals, 0.2 g from points, 0.5 and 1.5 g long; x that changes by 0.12 g."""
    random = np.random.default_rng(seed)
    ends = [
        v + step for v in (-1250, -750, -250, 250, 750, 1250) for step in (-200, -120, -1, 0, 1, 120, 160)
    ]
    means = random.choice([*ends, 0, 300, 400, 900, 1200], (400, 3))
    means[:8] = [
        [500, 0, 0], [300, 400, 0], [0, 0, 501], [0, 1500, 0], [900, 1200, 0], [0, 1, 1499], [0] * 3,
        [1000, 0, 0],
    ]  # fmt: skip
    means[8:12] = [[1000, 0, 200], [1000, 160, -120], [1000, 0, -199], [880, 160, 1]]
    counts = np.repeat(means, 10, axis=0).astype(np.int16)
    counts[::10, 0] += random.choice([0, 0, 119, 120, -119, -120], 400)
    recording = Recording(Path("borders"), "raw", 2.0, 1000.0, 0)
    made, records = by_the_package(recording, Stream(counts).chunks())
    assert by_the_header(driver, recording, records) == made


@pytest.mark.parametrize(
    "seed", [20, 21, 22, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (23, 24, 25))]
)
def test_nothing_that_c_leaves_undefined_happens(strict: Driver, seed: int) -> None:
    check_wild(strict, seed)
    check_fits(strict, sets_of_points(seed, 20))


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(26, 426))
def test_many_random_recordings_give_the_same_bits(driver: Driver, seed: int) -> None:
    check_wild(driver, seed)


def sets_of_points(seed: int, number: int) -> list[np.ndarray]:
    """Sets of 18 points, from well spread ones of a good sensor to ones from which the descent diverges."""
    random = np.random.default_rng(seed)
    sets = []
    for _ in range(number):
        spread = random_directions(random, 18) + random.choice([0, 2.0]) * random.standard_normal(3)
        v = measured(drawn_errors(random), spread / np.linalg.norm(spread, axis=1)[:, None])
        v = v * random.choice([1, 1, 0.6, 1.1, 1.3]) + random.choice([0.001, 0.2]) * random.standard_normal(
            (18, 3)
        )
        norms = np.linalg.norm(v, axis=1)[:, None]
        sets.append(np.rint(v * np.minimum(1, 1.499 / norms) * ONE).astype(np.int64))
    return sets


def check_fits(driver: Driver, sets: list[np.ndarray]) -> int:
    """Compare the fits, and what the error is said to be; gives how many diverged."""
    said = driver(np.stack(sets).astype("=i4").tobytes(), "fit")
    fits = [line for line in said if line[0] != "error"]
    errors = iter([int(value) for name, *rest in said if name == "error" for value in rest])
    diverged = 0
    for held, line in zip(sets, fits, strict=True):
        wanted = fitted(points(held / ONE))
        assert list(map(int, line[1:])) == wanted
        diverged += not wanted
        if wanted:
            k, o = wanted[:6], wanted[6:]
            x, y, z = (held + o).T.tolist()
            a = [[k[0] * b for b in x], [k[3] * b + k[1] * c for b, c in zip(x, y, strict=True)]]
            a.append([k[4] * b + k[5] * c + k[2] * d for b, c, d in zip(x, y, z, strict=True)])
            rounded = [[(value + (1 << 28)) >> 29 for value in row] for row in a]
            r = [
                (b * b + c * c + d * d - (1 << 58) + (1 << 28)) >> 29
                for b, c, d in zip(*rounded, strict=True)
            ]
            assert next(errors) == sum(map(abs, r)) // 36
    return diverged


def test_the_descent_gives_the_same_bits_or_diverges_as_well(driver: Driver) -> None:
    diverged = check_fits(driver, sets_of_points(1, 150))
    assert 5 < diverged < 120, "both kinds are tried"


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_collapses_is_no_fit(driver: Driver, axis: int) -> None:
    """Half of the points lie on a circle of radius 1 about it, half far from that: its best scale is 0."""
    angle = np.arange(18) // 2 * 2 * np.pi / 9
    v = np.insert(np.stack([np.cos(angle), np.sin(angle)], axis=1), axis, 0, axis=1)
    v[::4, axis], v[2::4, axis] = 0.97, -0.97
    held = points(v)
    with pytest.raises(DivergedError, match="an axis collapsed"):
        fixed32.fit(held, MODELS["9"], fixed32.PAPER)
    assert driver(held.xyz.astype("=i4").tobytes(), "fit") == [["diverged"]]


@pytest.mark.parametrize(
    ("length", "counts_per_g", "possible"),
    [(0, 256, False), (125, 0, False), (125, 256, True), (256, (1 << 24) - 1, True), (256, 1 << 24, False)],
)
def test_a_scale_that_does_not_fit_is_refused(
    driver: Driver, length: int, counts_per_g: int, possible: bool
) -> None:
    assert driver(b"", length, counts_per_g, 0) == ([] if possible else [["impossible"]])


def test_counts_of_32_bits_do_not_overflow(wide: Driver) -> None:
    """The largest sums that fit: rests at 1.49 g, where 1 g is 2**24 counts and 255 samples make a window."""
    recording = Recording(Path("large"), "csv", 51.0, float(1 << 24), 0)
    counts = np.rint(np.repeat(1.49 * directions(40), 255, axis=0) * (1 << 24)).astype(np.int32)
    made, records = by_the_package(recording, Stream(counts).chunks())
    assert len(made.fit) > 9 and by_the_header(wide, recording, records) == made


def test_windows_begin_anew_after_a_break_and_not_after_a_sample_that_was_not_measured(
    driver: Driver,
) -> None:
    one = [SAMPLE, 256, 0, 0]
    rows = [one] * 4 + [[BREAK, 0, 0, 0]] + [one] * 2 + [[UNMEASURED, 0, 0, 0]] + [one] * 7
    said = driver(np.array(rows, "=i4").tobytes(), 5, 256, 0)
    assert [line for line in said if line[0] == "window"] == [["window", "1", "4"], ["window", "5", "9"]]


def test_it_compiles_as_cpp(tmp_path: Path) -> None:
    """As sketches for Arduino boards do."""
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("there is no C++ compiler (c++)")
    source = tmp_path / "sketch.cpp"
    source.write_text((ROOT / "firmware" / "example.c").read_text())
    words = [compiler, "-std=c++11", *FLAGS[1:], "-fsyntax-only", f"-I{ROOT / 'firmware'}", str(source)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr


def test_cycles_of_instructions_are_arms() -> None:
    """By hand: three registers are pushed, then three times a load, a product, and a branch, taken twice."""
    text = """
00000848 <loop>:
 848:\tb5f0      \tpush\t{r4, r5, lr}
 84a:\tf851 3f04 \tldr.w\tr3, [r1, #4]!
 84e:\tfb83 4502 \tsmull\tr4, r5, r3, r2
 852:\td1fa      \tbne.n\t84a <loop+0x2>
 854:\tbd30      \tpop\t{r4-r5, pc}
 856:\tbf00      \tnop
"""
    table = measure.disassembled(text)
    assert {address: (size, name) for address, (size, name, _) in table.items()} == {
        0x848: (2, "push"), 0x84A: (4, "ldr"), 0x84E: (4, "smull"), 0x852: (2, "bne"), 0x854: (2, "pop"),
        0x856: (2, "nop"),
    }  # fmt: skip
    body = [0x84A, 0x84E, 0x852]
    executed = [0, 1, 0x848, *body * 3, 0x854, 2, 3]
    (pairs,) = measure.between(executed, 1, 2)
    assert pairs.total() == 10
    assert measure.cost(pairs, table) == (4 + 3 * (1 + 3 + 1) + 2 * 1, 5 + 3 * (3 + 5 + 1) + 2 * 3)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("measured_on", "tools"),
    [
        (measure.atmega328, ("avr-gcc", "simavr")),
        (measure.cortex_m3, ("arm-none-eabi-gcc", "qemu-system-arm")),
    ],
)
def test_microcontrollers_find_the_same_bits(measured_on: Callable[..., Any], tools: tuple[str, ...]) -> None:
    if absent := [tool for tool in tools if not shutil.which(tool)]:
        pytest.skip(f"{' and '.join(absent)} not found")
    assert measured_on(["-Os"]).parameters == measure.expected()


def test_the_header_keeps_its_promises() -> None:
    text = (ROOT / "firmware" / "accelcal.h").read_text()
    assert len(text.splitlines()) < 500
    words = set(text.replace("(", " ").replace(";", " ").split())
    assert not words & {"float", "double", "malloc", "free", "calloc", "realloc"}
    included = [line.split()[1] for line in text.splitlines() if line.startswith("#include")]
    assert included == ["<stdbool.h>", "<stdint.h>"]

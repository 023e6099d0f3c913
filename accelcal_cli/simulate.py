"""Simulated wrist wear with known errors, written as a recording next to which stands the truth about it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.errors import OutputError, UnreadableError, UsageError
from accelcal_cli.core.gyroscope import EQUATION
from accelcal_cli.core.identity import identity
from accelcal_cli.core.paths import is_file, is_there
from accelcal_cli.core.recording import Chunk, Device, Recording
from accelcal_cli.formats import all_encoders, named_encoder
from accelcal_cli.output.files import parsed, replacing, write_text
from accelcal_cli.pipeline.jobs import Progress, refuse_nameless, stem

# Simulated wrist wear: a stream of chunks from a sensor with known errors, and the truth about it.
#
# `SimulatedSensor` turns true acceleration into raw counts (the inverse of F eq. 7-9). Wear is made
# of bouts of sleep, desk work, walking, chores, and the watch left on a table; each gives true
# acceleration in g and says which samples are motionless. Directions are of the specific force at
# rest: a watch lying face up reads (0, 0, 1).

SCALE_ERROR = 0.05
MISALIGNMENT = 0.025
OFFSET_G = 0.05
GYRO_SCALE_ERROR, GYRO_MISALIGNMENT, GYRO_BIAS_DPS = 0.03, 0.02, 1.5
SPIN_DPS = 45.0
"""Speed [deg/s] at which the moving wrist turns about the vertical, which gravity does not show."""

SLEEP_POSTURES = (
    *((0.0, 0.1, -1.0), (-0.9, 0.2, -0.4), (0.3, -0.9, 0.3)),
    *((0.1, 0.4, 0.9), (0.8, 0.5, -0.2), (-0.3, 0.9, -0.1)),
)
DESK_POSTURES = ((0.1, -0.2, 0.97), (0.5, 0.1, 0.85), (-0.4, 0.5, 0.75), (-0.85, -0.2, 0.4))
TABLE = (0.02, -0.03, 1.0)
ARM_DOWN = (-0.97, 0.1, 0.2)
TURN_SECONDS = (0.6, 2.5)
SETTLE_SECONDS = 0.5
STILL_SECONDS = 10
START_US = 1_709_510_400_000_000
"""Time of the first sample [us since 1970], 2024-03-04T00:00:00."""

LARGEST_SEED = 4_000_000_000
"""Largest seed: others are made by adding up to 5 000 011, and the generator takes 2**32 - 1 at most."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SimulatedSensor:
    """A sensor with known errors, in the convention of the report: a = K (v + o + s (T - Tref)).

    Attributes:
        gain: K, (3, 3) lower triangular.
        offset_g: o, (3,).
        slope_g_per_c: s, (3,).
        noise_g: standard deviation of white noise on each axis.
    """

    gain: Floats
    offset_g: Floats
    slope_g_per_c: Floats
    noise_g: float
    lsb_per_g: float
    range_g: float
    reference_c: float = 30.0

    def counts(self, acceleration: Floats, temperature_c: Floats, random: RandomState) -> NDArray[np.int16]:
        """Return raw counts (n, 3) of true acceleration (n, 3) in g."""
        raw = acceleration @ np.linalg.inv(self.gain).T - self.offset_g
        if self.slope_g_per_c.any():
            raw -= np.multiply.outer(temperature_c - self.reference_c, self.slope_g_per_c)
        if self.noise_g:
            raw += self.noise_g * random.standard_normal(raw.shape)
        limit = round(self.range_g * self.lsb_per_g)
        return np.clip(np.rint(raw * self.lsb_per_g), -limit, limit - 1).astype(np.int16)

    def as_json(self) -> dict[str, Any]:
        """Return the truth file's `sensor` object."""
        names = ["gain", "offset_g", "slope_g_per_c", "reference_c", "noise_g", "lsb_per_g", "range_g"]
        return {name: np.asarray(getattr(self, name)).tolist() for name in names}


def draw_gain_and_offset(seed: int, size: float, misalignment: float) -> tuple[Floats, Floats]:
    """Draw errors uniformly from half of F's ranges (eq. 17), times `size`.

    Returns:
        K as in F eq. 18 (misalignment terms times the factor `misalignment`), and o in g.
    """
    draw = RandomState(seed).uniform(-1, 1, 9) * size
    scale = 1 + SCALE_ERROR * draw[:3]
    xy, xz, yz = MISALIGNMENT * misalignment * draw[3:6]
    gain = np.array(
        [[scale[0], 0, 0], [scale[1] * xy, scale[1], 0], [scale[2] * xz, scale[2] * yz, scale[2]]]
    )
    return gain, OFFSET_G * draw[6:]


@dataclass(frozen=True, slots=True)
class GyroSensor:
    """A gyroscope with known errors, in the convention of the report: w = S (r - b - c (T - Tref)).

    Attributes:
        scale: S, (3, 3).
        bias_dps: b, (3,); slope_dps_per_c: c, (3,).
        noise_dps: standard deviation of white noise on each axis.
    """

    scale: Floats
    bias_dps: Floats
    slope_dps_per_c: Floats
    noise_dps: float = 0.1
    lsb_per_dps: float = 16.384
    reference_c: float = 30.0

    def counts(self, rate_dps: Floats, temperature_c: Floats, random: RandomState) -> NDArray[np.int16]:
        """Return raw counts (n, 3) of true angular rates (n, 3) in the sensor's frame."""
        raw = rate_dps @ np.linalg.inv(self.scale).T + self.bias_dps
        raw += np.multiply.outer(temperature_c - self.reference_c, self.slope_dps_per_c)
        raw += self.noise_dps * random.standard_normal(raw.shape)
        return np.clip(np.rint(raw * self.lsb_per_dps), -32_768, 32_767).astype(np.int16)

    def as_json(self) -> dict[str, Any]:
        """Return the truth file's `gyroscope` object."""
        names = ["scale", "bias_dps", "slope_dps_per_c", "reference_c", "noise_dps", "lsb_per_dps"]
        return {"equation": EQUATION} | {name: np.asarray(getattr(self, name)).tolist() for name in names}


def draw_gyroscope(seed: int, size: float, slope_dps_per_c: Floats) -> GyroSensor:
    """Draw errors uniformly, of the size that devices have, times `size`."""
    draw = RandomState(seed + 5_000_011).uniform(-1, 1, 12) * size
    scale = np.eye(3) + GYRO_MISALIGNMENT * draw[:9].reshape(3, 3)
    scale[[0, 1, 2], [0, 1, 2]] = 1 + GYRO_SCALE_ERROR * draw[[0, 4, 8]]
    return GyroSensor(scale, GYRO_BIAS_DPS * draw[9:], slope_dps_per_c)


@dataclass(frozen=True, slots=True)
class Bout:
    """Some seconds of wear: acceleration (n, 3) in g, motionless samples (n,), and whether worn.

    Attributes:
        direction: (n, 3) unit vectors of gravity's part in the acceleration.
    """

    acceleration: Floats
    direction: Floats
    still: NDArray[np.bool_]
    worn: bool


def unit(vector: Floats) -> Floats:
    """Scale to length 1 along the last axis."""
    return np.asarray(vector / np.sqrt((vector**2).sum(axis=-1, keepdims=True)))


class Wearer:
    """Makes bouts one after another; the wrist turns from each posture to the next.

    Args:
        smooth: no movement begins with a leap, which a gyroscope could not follow.
    """

    def __init__(self, rate_hz: float, seed: int, *, smooth: bool = False) -> None:
        self.rate_hz = rate_hz
        self.smooth = smooth
        self.random = RandomState(seed)
        self.direction = unit(np.array(TABLE))

    def bouts(self) -> Iterator[Bout]:
        """Yield bouts without end, from midnight on."""
        seconds = 0.0
        while True:
            bout = self._bout(seconds / 3600 % 24)
            seconds += len(bout.still) / self.rate_hz
            yield bout

    def _bout(self, hour: float) -> Bout:
        chance = self.random.rand()
        if hour >= 23 or hour < 7:
            posture = self._near(SLEEP_POSTURES, 0.25)
            if chance < 0.8:
                return self._rest(posture, self._minutes(9.0, 0.8))
            return self._moving(posture, self.random.uniform(5, 60), 0.15)
        if 20.5 <= hour < 21 and chance < 0.5:
            bout = self._rest(self._near((TABLE,), 0.02), self.random.uniform(300, 1200))
            return replace(bout, worn=False)
        return self._day(chance)

    def _day(self, chance: float) -> Bout:
        if chance < 0.35:
            return self._rest(unit(self.random.randn(3)), self._minutes(0.6, 0.9))
        if chance < 0.6:
            return self._tremor(self._near(DESK_POSTURES, 0.3), self.random.uniform(10, 200))
        if chance < 0.8:
            return self._walking(self.random.uniform(30, 400))
        return self._moving(unit(self.random.randn(3)), self._minutes(0.9, 0.9), 0.35)

    def _minutes(self, median: float, spread: float) -> float:
        return float(np.clip(60 * median * np.exp(spread * self.random.randn()), 4, 3600))

    def _near(self, postures: tuple[tuple[float, float, float], ...], spread: float) -> Floats:
        chosen = np.array(postures[self.random.randint(len(postures))])
        return unit(chosen + spread * self.random.randn(3))

    def _turn(self, target: Floats, seconds: float) -> tuple[Floats, int]:
        """Return directions of a bout, a smooth turn to the target and then hold; and the turn's samples."""
        number = max(2, round(seconds * self.rate_hz))
        turning = min(number, max(1, round(self.random.uniform(*TURN_SECONDS) * self.rate_hz)))
        start = self.direction
        if float(start @ target) < -0.98:
            start = unit(start + 0.2 * self.random.randn(3))
        share = np.ones(number)
        share[:turning] = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, turning + 1) / turning)
        path = unit(start * (1 - share)[:, None] + target * share[:, None])
        self.direction = path[-1]
        return path, turning

    def _rest(self, target: Floats, seconds: float) -> Bout:
        path, turning = self._turn(target, seconds)
        still = np.zeros(len(path), np.bool_)
        still[turning + round(SETTLE_SECONDS * self.rate_hz) :] = True
        return Bout(path, path, still, worn=True)

    def _tremor(self, target: Floats, seconds: float) -> Bout:
        path, _ = self._turn(target, seconds)
        size = self.random.uniform(0.004, 0.03)
        shaken = path + self._waves(len(path), size, 0.3, 9.0)
        return Bout(shaken, unit(shaken), np.zeros(len(path), np.bool_), worn=True)

    def _moving(self, target: Floats, seconds: float, size: float) -> Bout:
        path, _ = self._turn(target, seconds)
        swaying = unit(path + self._waves(len(path), size, 0.1, 0.6))
        self.direction = swaying[-1]
        shaken = swaying + self._waves(len(path), size * self.random.uniform(0.2, 1.0), 0.5, 4.0)
        return Bout(shaken, swaying, np.zeros(len(path), np.bool_), worn=True)

    def _walking(self, seconds: float) -> Bout:
        path, _ = self._turn(self._near((ARM_DOWN,), 0.15), seconds)
        steps = self.random.uniform(1.6, 2.1)
        time = np.arange(len(path)) / self.rate_hz
        swing = self.random.uniform(0.1, 0.5) * np.sin(np.pi * steps * time + 6.28 * self.random.rand())
        impact = self.random.uniform(0.1, 0.6) * np.sin(2 * np.pi * steps * time) ** 3
        side = unit(self.random.randn(3))
        swung = unit(path + swing[:, None] * side * self._beginning(len(path)))
        self.direction = swung[-1]
        return Bout(swung * (1 + impact)[:, None], swung, np.zeros(len(path), np.bool_), worn=True)

    def _waves(self, number: int, size: float, low_hz: float, high_hz: float) -> Floats:
        time = np.arange(number)[:, None] / self.rate_hz
        frequency = self.random.uniform(low_hz, high_hz, 3)
        waves = size * np.sin(2 * np.pi * (frequency * time + self.random.rand(3)))
        return np.asarray(waves * self._beginning(number))

    def _beginning(self, number: int) -> Floats:
        """Return the factor of movements, (n, 1): smooth ones grow within a second."""
        if not self.smooth:
            return np.ones((number, 1))
        return np.minimum(1.0, np.arange(number) / self.rate_hz)[:, np.newaxis]


@dataclass(frozen=True, slots=True)
class SimulationPlan:
    """The settings of a simulation.

    Attributes:
        unit_samples: the number of samples is cut to a multiple of this.
    """

    days: float
    rate_hz: float
    seed: int
    sensor: SimulatedSensor
    temperature: bool = True
    unit_samples: int = 1
    gyroscope: GyroSensor | None = None

    @property
    def samples(self) -> int:
        """Number of samples."""
        wanted = round(self.days * 86_400 * self.rate_hz)
        return wanted - wanted % self.unit_samples


@dataclass(slots=True)
class Truth:
    """Errors over the motionless 10 s stretches, before and with the true parameters [mg]."""

    stretches: int = 0
    before: list[float] = field(default_factory=list)
    after: list[float] = field(default_factory=list)

    def see(self, counts: NDArray[np.int16], temperature: Floats, sensor: SimulatedSensor) -> None:
        """Take in one motionless stretch."""
        mean = counts.mean(axis=0) / sensor.lsb_per_g
        moved = mean + sensor.offset_g + sensor.slope_g_per_c * (temperature.mean() - sensor.reference_c)
        self.stretches += 1
        self.before.append(abs(float(np.sqrt((mean**2).sum())) - 1) * 1000)
        self.after.append(abs(float(np.sqrt(((sensor.gain @ moved) ** 2).sum())) - 1) * 1000)

    def as_json(self) -> dict[str, Any]:
        """Return the truth file's `still` object."""
        before, after = (sum(one) / len(one) if one else None for one in (self.before, self.after))
        means = {"before_mg": before, "with_true_parameters_mg": after}
        return {"stretches": self.stretches, "seconds": STILL_SECONDS} | means


def describe(plan: SimulationPlan, path: Path, format_name: str) -> Recording:
    """Return the description of the recording for its writer."""
    return Recording(
        path=path,
        format=format_name,
        rate_hz=plan.rate_hz,
        lsb_per_g=plan.sensor.lsb_per_g,
        total_bytes=0,
        device=Device("simulated", f"SIM{plan.seed:05d}", None),
        range_g=plan.sensor.range_g,
        start_us=START_US,
        samples=plan.samples,
        has_temperature=plan.temperature,
        gyro_dps_per_lsb=None if plan.gyroscope is None else (1 / plan.gyroscope.lsb_per_dps,) * 3,
    )


def stream(plan: SimulationPlan, truth: Truth) -> Iterator[Chunk]:
    """Yield the chunks of a plan, one a bout, and fill `truth` on the way."""
    noise = RandomState(plan.seed + 1_000_003)
    rate = rate_fraction(plan.rate_hz)
    turning = None if plan.gyroscope is None else Turning(plan.gyroscope, plan.rate_hz, plan.seed)
    done, length = 0, round(STILL_SECONDS * plan.rate_hz)
    for bout in Wearer(plan.rate_hz, plan.seed, smooth=turning is not None).bouts():
        number = min(len(bout.still), plan.samples - done)
        temperature = temperature_c(done, number, plan.rate_hz, worn=bout.worn)
        counts = plan.sensor.counts(bout.acceleration[:number], temperature, noise)
        still = np.flatnonzero(bout.still[:number])
        if len(still):
            for start in range(int(still[0]), number - length + 1, length):
                part = slice(start, start + length)
                truth.see(counts[part], temperature[part], plan.sensor)
        yield Chunk(
            done,
            counts,
            UniformClock(START_US, done, rate),
            0,
            temperature_mc=np.rint(temperature * 1000).astype(np.int32) if plan.temperature else None,
            gyro_counts=None if turning is None else turning.counts(bout.direction[:number], temperature),
        )
        done += number
        if done == plan.samples:
            return


class Turning:
    """Simulates a gyroscope while gravity's direction moves, one bout after another."""

    def __init__(self, sensor: GyroSensor, rate_hz: float, seed: int) -> None:
        self._sensor, self._rate_hz = sensor, rate_hz
        self._random = RandomState(seed + 2_000_003)
        self._before = unit(np.array(TABLE))

    def counts(self, direction: Floats, temperature: Floats) -> NDArray[np.int16]:
        """Return raw counts (n, 3) of a bout with these directions (n, 3)."""
        before = np.concatenate([self._before[np.newaxis], direction[:-1]])
        self._before = direction[-1]
        rates = self._rates(before, direction)
        return self._sensor.counts(rates, temperature, self._random)

    def _rates(self, before: Floats, after: Floats) -> Floats:
        """Return the angular rates [deg/s] by which each direction becomes the next, exactly, (n, 3).

        They are the shortest turn that does so, then one about the new direction, as one turn: the product of
        their quaternions. A direction that is fixed in the room turns the other way than the sensor.
        """
        across, along = np.cross(after, before), (after * before).sum(axis=1)
        shortest = np.column_stack([1 + along, across])
        angle = np.degrees(np.arctan2(np.sqrt((across**2).sum(axis=1)), along))
        share = np.minimum(1.0, angle * self._rate_hz / SPIN_DPS)
        spin = np.radians(self._random.uniform(-SPIN_DPS, SPIN_DPS) * share / self._rate_hz) / 2
        w, v = shortest[:, :1], shortest[:, 1:]
        c, a = np.cos(spin)[:, np.newaxis], np.sin(spin)[:, np.newaxis] * after
        real = w * c - (v * a).sum(axis=1, keepdims=True)
        vector = w * a + c * v + np.cross(v, a)
        length = np.sqrt((vector**2).sum(axis=1, keepdims=True))
        turned = 2 * np.arctan2(length, real)
        return np.asarray(np.degrees(turned * vector / np.maximum(length, 1e-300)) * self._rate_hz)


def temperature_c(first: int, number: int, rate_hz: float, *, worn: bool) -> Floats:
    """Return skin temperature with a daily and a faster swing; some degrees less off the wrist."""
    seconds = (first + np.arange(number)) / rate_hz
    swing = 3.5 * np.sin(2 * np.pi * (seconds / 86_400 - 0.2)) + 1.2 * np.sin(2 * np.pi * seconds / 5400)
    return np.asarray(29.0 + swing - (0.0 if worn else 5.0))


# Writes a simulated recording and the truth about it, and reads that truth again.

TRUTH_SUFFIX = ".truth.json"
SLOPE, NO_SLOPE = "temp_slope_g_per_c", (0.0, 0.0, 0.0)


def plan_of(values: dict[str, Any]) -> SimulationPlan:
    """Return the plan of the options of `simulate`; raises UsageError if they do not go together."""
    if values["range_g"] * values["lsb_per_g"] > 32_768:
        raise UsageError("--range-g times --lsb-per-g does not fit in 16 bits", hint="reduce one of them")
    truth = values["seed"] if values["truth"] is None else values["truth"]
    gain, offset = draw_gain_and_offset(truth, values["errors"], values["misalignment"])
    sensor = SimulatedSensor(
        gain=gain,
        offset_g=offset,
        slope_g_per_c=np.array(values["temp_slope"]) / 1000,
        noise_g=values["noise_mg"] / 1000,
        lsb_per_g=values["lsb_per_g"],
        range_g=values["range_g"],
    )
    slope = np.array(values["gyro_temp_slope"])
    if slope.any() and not values["gyro"]:
        raise UsageError("--gyro-temp-slope is of a gyroscope", hint="add --gyro")
    gyroscope = draw_gyroscope(truth, values["errors"], slope) if values["gyro"] else None
    warm = not values["no_temperature"]
    return SimulationPlan(
        values["days"], values["rate_hz"], values["seed"], sensor, warm, gyroscope=gyroscope
    )


def simulate(
    out: Path, format_name: str, plan: SimulationPlan, *, force: bool, progress: Progress
) -> tuple[Path, dict[str, Any]]:
    """Write OUT with the format's suffix, its companion if it needs one, and OUT.truth.json.

    Returns:
        the recording's path and the truth.

    Raises:
        UsageError: the format has no writer, or none for such a rate, scale or length; OUT has no name.
        OutputError: a file exists already and `force` is not given, or cannot be written.
    """
    encoder = named_encoder(format_name)
    if plan.gyroscope is not None and not encoder.gyroscope:
        others = ", ".join(one.name for one in all_encoders() if one.gyroscope)
        raise UsageError(f"{format_name} is not written with a gyroscope", hint=f"use one of {others}")
    sampling = encoder.sampling(describe(plan, out, format_name))
    plan = replace(plan, rate_hz=sampling.rate_hz, unit_samples=sampling.unit_samples)
    if plan.samples < 1:
        raise UsageError("nothing to simulate", hint="raise --days")
    refuse_nameless(out)
    base = out.parent / (out.name.removesuffix(encoder.suffix) or out.name)
    path = base.with_name(base.name + encoder.suffix)
    truth_path = base.with_name(base.name + TRUTH_SUFFIX)
    companion = None if encoder.companion is None else base.with_name(base.name + encoder.companion.suffix)
    for target in (path, truth_path, companion):
        if target is not None and is_there(target) and not force:
            raise OutputError("exists already", path=target, hint="use --force to replace it")
    truth = Truth()
    recording = describe(plan, path, format_name)
    with replacing(path) as temporary:
        encoder.write(temporary, recording, _counted(stream(plan, truth), progress))
    if encoder.companion is not None and companion is not None:
        write_text(companion, encoder.companion.text(recording))
    truth_json = _truth_json(plan, truth, format_name)
    write_text(truth_path, json.dumps(truth_json, indent=2) + "\n")
    return path, truth_json


def _counted(chunks: Iterator[Chunk], progress: Progress) -> Iterator[Chunk]:
    for chunk in chunks:
        yield chunk
        progress(chunk.first_sample + len(chunk))


def _truth_json(plan: SimulationPlan, truth: Truth, format_name: str) -> dict[str, Any]:
    return {
        **identity("truth"),
        "format": format_name,
        "days": plan.days,
        "rate_hz": plan.rate_hz,
        "seed": plan.seed,
        "samples": plan.samples,
        "equation": "a = K (v + o + s (T - Tref))",
        "sensor": plan.sensor.as_json(),
        **({} if plan.gyroscope is None else {"gyroscope": plan.gyroscope.as_json()}),
        "still": truth.as_json(),
    }


@dataclass(frozen=True, slots=True, eq=False)
class TrueParameters:
    """True parameters: a = K (v + o + s (T - Tref)).

    Attributes:
        gain: K, (3, 3).
        offset_g: o, (3,) at the reference temperature.
        reference_c: Tref.
        slope_g_per_c: s, (3,).
    """

    gain: NDArray[np.float64]
    offset_g: NDArray[np.float64]
    reference_c: float
    slope_g_per_c: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))


def true_parameters(recording: Path) -> TrueParameters | None:
    """Return the content of STEM.truth.json next to a recording; None if there is no such file.

    The file is as `accelcal simulate` writes it, or has the keys `K` and `b` (and `temp_ref_c`) of
    a = K (v - b - s (T - Tref)).

    Raises:
        UnreadableError: the file holds something else.
    """
    path = recording.with_name(stem(recording) + TRUTH_SUFFIX)
    if not is_file(path):
        return None
    try:
        known = parsed(path.read_text("utf-8"))
        if "sensor" in known:
            sensor = known["sensor"]
            slope = sensor.get("slope_g_per_c", NO_SLOPE)
            return _checked(sensor["gain"], sensor["offset_g"], sensor["reference_c"], slope)
        offset, slope = ([-value for value in values] for values in (known["b"], known.get(SLOPE, NO_SLOPE)))
        return _checked(known["K"], offset, known.get("temp_ref_c", 0.0), slope)
    except (OSError, ValueError, KeyError, TypeError) as error:
        text = f"does not hold the truth of a simulated recording ({error})"
        hint = "move it away, or write it again with accelcal simulate"
        raise UnreadableError(text, path=path, hint=hint) from error


def _checked(gain: Any, offset_g: Any, reference_c: Any, slope_g_per_c: Any) -> TrueParameters:
    k, offset, slope = (np.array(value, np.float64) for value in (gain, offset_g, slope_g_per_c))
    truth = TrueParameters(k, offset, float(reference_c), slope)
    if truth.gain.shape != (3, 3) or not truth.offset_g.shape == truth.slope_g_per_c.shape == (3,):
        raise ValueError("K is not 3 x 3, or o or s not three numbers")
    return truth

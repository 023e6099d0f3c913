"""APDM Opal files: two sensors as the vendor lays them out, with parts missing, odd or of other lengths."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_opal
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth
from tests.fuzz.mutate_hdf5 import RATE, ROWS, VALUES, counts, damaged, file_of

SUFFIX = ".h5"
START_US = 1_709_510_400_000_000
WRIST = ReadOptions(sensor="left wrist")
PATHS = ("Accelerometer", "Gyroscope", "Temperature", "Time", "Configuration", "Magnetometer")
KEYS = ("Sample Rate", "Label 0", "Timezone", "Firmware Version", "Units", "Upper Limit", "FileFormatVersion")
JUMPS_US = (1, 20_000, 10**6, 3600 * 10**6, 10**14, 10**18)


def times(random: Random) -> np.ndarray:
    values = START_US + np.arange(ROWS, dtype=np.int64) * round(1e6 / RATE)
    at, form, step = random.randrange(ROWS), random.randrange(8), random.choice(JUMPS_US)
    if form == 0:
        values[at:] += step
    if form == 1:
        values[at : at + 40] += step
    if form == 2:
        values[at:] -= min(step, START_US)
    if form == 3:
        values[at : at + 20] = values[at]
    if form == 4:
        values = values[::-1].copy()
    return values


def sound(file: Any, random: Random) -> Truth:
    """Two sensors whose times are odd at most; the rows of the second."""
    file.attrs["FileFormatVersion"] = np.uint32(5)
    values = counts() / 256
    when = times(random)
    make_opal.add_sensor(file, ("XI-000001", "Lumbar"), -values, when, RATE)
    made = make_opal.add_sensor(file, ("XI-000002", "Left Wrist"), values, when, RATE)
    missing = np.zeros(ROWS, bool)
    if random.random() < 0.3:
        at = random.randrange(ROWS)
        made["Accelerometer"][at : at + random.choice([1, 50])] = random.choice([np.nan, np.inf])
        missing = ~np.isfinite(made["Accelerometer"][:]).all(axis=1)
    return Truth(values[~missing], values[~missing], int(missing.any()))


def absurd(file: Any, random: Random) -> None:
    sound(file, random)
    for _ in range(random.choice([1, 1, 2, 4])):
        group = file[f"Sensors/XI-00000{random.choice([1, 2])}"]
        name, form = random.choice(PATHS), random.randrange(4)
        if form == 0 and name in group:
            del group[name]
        elif form == 1 and name in group:
            del group[name]
            shape = random.choice([(ROWS,), (ROWS, 3), (ROWS - 1, 3), (0, 3), (3, ROWS), (1,)])
            group.create_dataset(name, data=np.zeros(shape, random.choice(["f4", "f8", "u8", "S3", "i2"])))
        else:
            nodes = [file, group, *(group[key] for key in PATHS if key in group)]
            random.choice(nodes).attrs[random.choice(KEYS)] = random.choice(VALUES)


def mutant(random: Random) -> Mutant:
    choice = random.random()
    if choice < 0.4:
        data, truth = file_of(random, sound)
        return Mutant(data, "sound", truth, WRIST)
    data, _ = file_of(random, absurd if choice < 0.75 else sound)
    how = random.choice([damaged, blind]) if choice >= 0.75 else None
    options = random.choice([WRIST, WRIST, ReadOptions(), ReadOptions(sensor="trunk")])
    return Mutant(how(data, random) if how else data, how.__name__ if how else "absurd", None, options)

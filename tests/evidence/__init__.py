"""What the package makes of every recording at hand, frozen before a change and compared after it.

`python -m tests.evidence freeze FILE.json` runs the package that PYTHONPATH names first, else the installed
one; `python -m tests.evidence compare OLD.json NEW.json` prints what differs. Differences that were decided
stand in `settled.txt`, each with its reason.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, NamedTuple

from tests.conftest import ROOT, shared_folder
from tests.test_real_recordings import NILSPOD

HERE = Path(__file__).resolve().parent
NO_RECORDINGS = (".md", ".py", ".sh", ".truth.json")
PROSE = ("hint", "message", "mixed_times", "notes", "own_message", "why")
"""Keys of sentences in reports, errors and tables of studies."""

ABSENT = object()
STUDIES = ("vendor", "cases", "tables")
SHOWN = 80
"""Most characters that are shown of a value."""

OPTIONS = {
    "vendor/apdm_opal.h5": ["--sensor|Right Wrist"],
    "cases/01_two_sensors_interleaved.csv.gz": ["--sensor|left", "--sensor|right"],
    "cases/03_two_devices_by_location.csv.gz": ["--sensor|lw", "--sensor|rw"],
    "cases/22_comma_before_milliseconds.csv.gz": ["--rate|25"],
    "cases/32_adc_10bit_zero_512.csv.gz": ["--unit|counts|--lsb-per-g|102", "-R|zero=512|--lsb-per-g|103"],
    "hostile3/loc_quote.csv.gz": ["--sensor|right"],
    "imu/ferraris_session.csv": ["--rate|102.4"],
    "imu/mpu9150_imu0.log": ["--columns|0,1,2|--unit|m/s2|--rate|100"],
    "imu/mpu9150_imu1.log": ["--columns|0,1,2|--unit|m/s2|--rate|100"],
    "imu/nilspod_84965c0.bin": ["--layout|OUT/nilspod.toml"],
    "imu/nilspod_92338c81.bin": ["--layout|OUT/nilspod.toml"],
    "imu/xsens_mti_acc.txt": ["--unit|counts|-R|zero=33000|--lsb-per-g|3400"],
    "tables/26_unnamed_last_number.csv.gz": ["-R|time_format=ms"],
    "verdicts/no_gravity_g.csv.gz": ["--unit|g"],
    "verdicts/x_gain_x1.45.csv.gz": ["--unit|g"],
}
"""Options that a README names, or that the refusal without them asks for; each file is also run without."""


Tasks = dict[str, tuple[Path, tuple[str, ...]]]
"""Words of commands by name, each with its folder, so that no path of this machine is in its results."""


def tasks_of(data: Path) -> Tasks:
    """Return a task for each file and folder in the folders of a folder, and for each study of these."""
    tasks: Tasks = {}
    for path in sorted(data.glob("*/**/*")):
        name = path.relative_to(data).as_posix()
        if not name.endswith(NO_RECORDINGS):
            for options in ("", *OPTIONS.get(name, ())):
                words = (name, *filter(None, options.split("|")))
                tasks[" ".join(words)] = data, ("calibrate", *words)
    studies = [name for name in STUDIES if (data / name).is_dir()]
    return tasks | {f"study {name}": (data, ("study", name, "-j", "1")) for name in studies}


def every_task() -> Tasks:
    """Return the tasks of the samples, and of the shared recordings if they are here."""
    data = shared_folder()
    samples = {f"sample_data/{name}": (ROOT, ("calibrate", f"sample_data/{name}"))
               for name in ("evening.csv.gz", "night.h5", "recording.bin", "six_faces.csv.gz")}  # fmt: skip
    return samples | ({} if data is None else tasks_of(data))


def freeze(tasks: Tasks, jobs: int = 1) -> dict[str, Any]:
    """Return the evidence of each task by its name; each runs in a process of its own."""
    named = [place for place in os.environ.get("PYTHONPATH", "").split(os.pathsep) if place]
    package = PathFinder.find_spec("accelcal_cli", [*named, *sys.path])
    assert package is not None and package.origin is not None
    root = str(Path(package.origin).parent.parent)
    with ThreadPoolExecutor(jobs) as threads:
        found = threads.map(lambda task: _evidence(root, *task), tasks.values())
        return dict(sorted(zip(tasks, found, strict=True)))


def _evidence(root: str, folder: Path, words: Sequence[str]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as out:
        (Path(out) / "nilspod.toml").write_text(NILSPOD.format(header=0))
        ended = subprocess.run(
            [sys.executable, "-P", str(HERE / "record.py"), out, *words, "-d", "OUT", "-q"],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": root, "TMPDIR": out},
            capture_output=True,
            check=False,
        )
        if (written := Path(out) / "evidence.json").exists():
            return dict(json.loads(written.read_text()))
        last = ended.stderr.decode().splitlines()[-1:]
        limited = ended.returncode == -signal.SIGKILL or "MemoryError" in last
        return {"killed": "by a limit of record.py" if limited else [ended.returncode, *last]}


def differences(one: Any, other: Any, place: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the key path of each difference of two JSON values, and what stands there; ABSENT for nothing."""
    if isinstance(one, dict) and isinstance(other, dict):
        for name in sorted({*one, *other}):
            inner = f"{place}.{name}".removeprefix(".")
            yield from differences(one.get(name, ABSENT), other.get(name, ABSENT), inner)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, (left, right) in enumerate(zip(one, other, strict=True)):
            yield from differences(left, right, f"{place}[{index}]")
    elif one is ABSENT or other is ABSENT or json.dumps(one) != json.dumps(other):
        yield place, one, other


def without_prose(value: Any) -> Any:
    """Return a JSON value without its sentences; what has the name of one but holds codes stays."""
    if isinstance(value, dict):
        kept = (name for name, one in value.items() if name not in PROSE or not _is_text(one))
        return {name: without_prose(value[name]) for name in kept}
    return [without_prose(one) for one in value] if isinstance(value, list) else value


def _is_text(value: Any) -> bool:
    return all(isinstance(one, str | None) for one in (value if isinstance(value, list) else [value]))


class Rule(NamedTuple):
    """A difference that was decided: patterns of its key path and of its recordings, and the reason."""

    key: str
    files: str
    reason: str


def rules_of(path: Path = HERE / "settled.txt") -> list[Rule]:
    """Read lines `KEY-REGEX  FILE-GLOB  # REASON`; raises ValueError for a line without its three parts."""
    lines = [line for line in path.read_text("utf-8").splitlines() if line and not line.startswith("#")]
    found = [re.fullmatch(r"(\S+)\s+(.+?)\s+# (.+)", line) for line in lines]
    if None in found:
        raise ValueError(f"not KEY-REGEX  FILE-GLOB  # REASON: {lines[found.index(None)]}")
    return [Rule(*one.groups()) for one in found if one is not None]


def compare(
    old: dict[str, Any], new: dict[str, Any], rules: Sequence[Rule] = (), *, ignore_prose: bool = False
) -> tuple[list[str], int]:
    """Return lines that tell the differences by recording and by key, and how many are not settled."""
    lines: list[str] = []
    keys: Counter[str] = Counter()
    settled: Counter[Rule] = Counter()
    if ignore_prose:
        old, new = without_prose(old), without_prose(new)
    for name in sorted({*old, *new}):
        told = []
        for key, *values in differences(old.get(name, ABSENT), new.get(name, ABSENT)):
            held = [one for one in rules if re.fullmatch(one.key, key) and fnmatch(name, one.files)]
            settled.update(held[:1])
            if not held:
                told.append(f"  {key or 'all of it'}: {' -> '.join(map(_shown, values))}")
                keys[re.sub(r"\[\d+\]", "[]", key)] += 1
        lines += [name, *told] if told else []
    lines += [f"{number} {key or 'recordings in one of the two'}" for key, number in keys.most_common()]
    lines += [f"settled: {settled[rule]} {rule.key} {rule.files}: {rule.reason}" for rule in rules]
    return [*lines, f"{keys.total()} differences, {settled.total()} settled"], keys.total()


def _shown(value: Any) -> str:
    text = "nothing" if value is ABSENT else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}... ({len(text)})"

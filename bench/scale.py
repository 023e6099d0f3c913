"""`make bench-scale`: what a study of 100 000 recordings costs.

What does not calibrate is measured at full size, on links to a few short recordings: planning, a part, a
run that finds all done. The work is measured on a hundredth, on a disk that is far away, and on weeks
of 100 Hz.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from accelcal_cli.cli.output import aligned
from accelcal_cli.pipeline.jobs import file_stamp

ACCELCAL = [sys.executable, "-m", "accelcal_cli"]
KINDS, FOLDERS = 10, 20
SAMPLE_S = 0.1
FAR_US, BYTE_NS = (0, 500, 2000), 10
"""Microseconds a call to a disk that is far away, and nanoseconds a byte: 100 MB/s."""


@dataclass
class Cost:
    """What a study cost.

    Attributes:
        cpu_s: of all its processes; of the first alone `main_cpu_s`.
        main_mb: peak memory of the first process; `worker_mb` of the largest other.
        files: the most that the first process had open.
    """

    wall_s: float = 0.0
    cpu_s: float = 0.0
    main_cpu_s: float = 0.0
    main_mb: float = 0.0
    worker_mb: float = 0.0
    files: int = 0


def measured(*words: object, environment: Mapping[str, str] | None = None) -> Cost:
    """Run accelcal to its end; raises CalledProcessError unless it ends with 0, or 1 for refusals."""
    began, cost, cpu = time.monotonic(), Cost(), dict[int, float]()
    process = subprocess.Popen(
        [*ACCELCAL, *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, **(environment or {})},
    )
    while process.poll() is None:
        for number, seconds, megabytes in _session(process.pid):
            cpu[number] = seconds
            kind = "main_mb" if number == process.pid else "worker_mb"
            setattr(cost, kind, max(getattr(cost, kind), megabytes))
        with contextlib.suppress(OSError):
            cost.files = max(cost.files, len([*Path(f"/proc/{process.pid}/fd").iterdir()]))
        time.sleep(SAMPLE_S)
    if process.returncode not in (0, 1):
        raise subprocess.CalledProcessError(process.returncode, list(map(str, words)))
    cost.wall_s, cost.cpu_s = time.monotonic() - began, sum(cpu.values())
    cost.main_cpu_s = cpu.get(process.pid, 0.0)
    return cost


def _session(leader: int) -> Iterator[tuple[int, float, float]]:
    """Number, processor time and peak memory [MB] of each process of a session (proc(5))."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[3]) == leader:
                seconds = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
                status = (path.parent / "status").read_text().splitlines()
                peak = next((int(line.split()[1]) for line in status if line.startswith("VmHWM")), 0)
                yield int(path.parent.name), seconds, peak / 1024


def recordings(folder: Path, number: int) -> Path:
    """A folder of so many recordings of five hours, links to a few; made if it is not there."""
    kinds = folder / "kinds"
    for kind in range(KINDS):
        path = kinds / f"k{kind}.cwa"
        if not path.exists():
            kinds.mkdir(parents=True, exist_ok=True)
            made = ("--format", "cwa", "--days", "0.2", "--rate", "12.5", "--seed", str(kind + 1), "-q")
            subprocess.run([*ACCELCAL, "simulate", str(path), *made], check=True)
            path.with_name(path.name + ".truth.json").unlink(missing_ok=True)
    top = folder / f"in{number}"
    if not top.exists():
        for index in range(number):
            path = top / f"site{index % FOLDERS:02}" / f"p{index:06}.cwa"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.hardlink_to(kinds / f"k{index % KINDS}.cwa")
    return top


def remembered(folder: Path, top: Path) -> Path:
    """A folder of outputs with the results and the ledger of a study of all recordings, made of a few."""
    done, out = folder / "kinds_out", folder / f"{top.name}_out"
    if out.exists():
        shutil.rmtree(out)
    measured("study", folder / "kinds", "-d", done, "-q")
    lines = [line.partition(b" ")[2] for line in (done / "study.ledger").read_bytes().splitlines()]
    known = {entry["name"]: entry for entry in map(json.loads, filter(None, lines))}
    out.mkdir()
    with (out / "study.ledger").open("w") as ledger:
        for path in sorted(top.rglob("*.cwa")):
            name = path.relative_to(top).with_suffix("").as_posix()
            kind = f"k{int(path.stem[1:]) % KINDS}"
            entry = dict(known[f"{kind}.cwa"])
            outputs = [(done / one, out / f"{name}{one.removeprefix(kind)}") for one, _ in entry["outputs"]]
            for source, target in outputs:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.hardlink_to(source)
            entry |= {"name": f"{name}.cwa", "row": {**entry["row"], "path": f"{name}.cwa"}}
            entry["stamps"] = [file_stamp(path), *entry["stamps"][1:]]
            entry["outputs"] = [(str(target.relative_to(out)), file_stamp(target)) for _, target in outputs]
            text = json.dumps(entry)
            ledger.write(f"{zlib.crc32(text.encode()):08x} {text}\n")
    return out


def steps(options: argparse.Namespace) -> Iterator[tuple[str, Cost]]:
    """Each step and what it cost."""
    folder: Path = options.folder.absolute()
    if options.files:
        many = recordings(folder, options.files)
        plan = ("study", many, "-d", folder / "none", "--dry-run", "-q")
        yield f"plan {options.files}", measured(*plan)
        yield f"plan a hundredth of {options.files}", measured(*plan, "--shard", "1/100")
        out = remembered(folder, many)
        yield f"find {options.files} done", measured("study", many, "-d", out, "-q")
    for jobs, number in ((1, options.works // 4), (2, options.works)) if options.works else ():
        some, out = recordings(folder, number), folder / f"works{jobs}"
        shutil.rmtree(out, ignore_errors=True)
        yield f"{number} recordings, -j {jobs}", measured("study", some, "-d", out, "-q", "-j", jobs)
    for delay in FAR_US if options.far else ():
        few, out = recordings(folder, options.far), folder / f"far{delay}"
        shutil.rmtree(out, ignore_errors=True)
        slow, far, more = _far(folder, delay), f"{delay / 1000:g} ms a call", 10 * options.far
        plan = ("study", recordings(folder, more), "-d", folder / "none", "--dry-run", "-q")
        yield f"plan {more}, {far}", measured(*plan, environment=slow)
        work = ("study", few, "-d", out, "-q", "-j", 2)
        yield f"{options.far} recordings, -j 2, {far}", measured(*work, environment=slow)
    for jobs, weeks in ((1, 2), (2, 4)) if options.weeks else ():
        top, out = _weeks(folder, weeks), folder / f"weeks{jobs}"
        shutil.rmtree(out, ignore_errors=True)
        yield f"{weeks} weeks of 100 Hz, -j {jobs}", measured("study", top, "-d", out, "-q", "-j", jobs)
        shutil.rmtree(out)


def _far(folder: Path, delay: int) -> dict[str, str]:
    """The environment in which the folder is far away."""
    shim, source = folder / "slow.so", Path(__file__).with_name("slow.c")
    words = ["cc", "-shared", "-fPIC", "-O1", "-o", str(shim), str(source), "-ldl"]
    subprocess.run(words, check=True)
    bytes_ns = BYTE_NS if delay else 0
    where = {"LD_PRELOAD": str(shim), "ACCELCAL_SLOW_UNDER": str(folder)}
    return {**where, "ACCELCAL_SLOW_US": str(delay), "ACCELCAL_SLOW_NS": str(bytes_ns)}


def _weeks(folder: Path, number: int) -> Path:
    week, top = folder / "week.cwa", folder / f"weeks_in{number}"
    if not week.exists():
        made = ("--format", "cwa", "--days", "7", "--rate", "100", "--seed", "3", "-q")
        subprocess.run([*ACCELCAL, "simulate", str(week), *made], check=True)
    top.mkdir(exist_ok=True)
    for index in range(number):
        with contextlib.suppress(FileExistsError):
            (top / f"w{index}.cwa").hardlink_to(week)
    return top


def main() -> None:
    """Time what is asked for, print a table, write it as JSON."""
    parser = argparse.ArgumentParser(prog="python -m bench.scale")
    parser.add_argument("--folder", type=Path, default=Path("bench_data/scale"))
    parser.add_argument("--files", type=int, default=100_000, help="planned and found done; 0 for none")
    parser.add_argument("--works", type=int, default=1000, help="calibrated; 0 for none")
    parser.add_argument("--far", type=int, default=40, help="on a disk that is far away; 0 for none")
    parser.add_argument("--weeks", type=int, default=1, help="weeks of 100 Hz, too; 0 for none")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, cost in steps(options):
        rows.append({"step": name, **{key: round(value, 2) for key, value in asdict(cost).items()}})
        print(json.dumps(rows[-1]), flush=True)
    print(aligned(tuple(rows[0]), [[str(cell) for cell in row.values()] for row in rows]))
    (options.folder / "latest.json").write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()

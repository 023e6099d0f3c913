"""The commands that faults are tried on, each with small inputs, and what lies in its folder before it."""

from __future__ import annotations

import re
import shutil
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.cli.studies import run_in
from tests.recordings import directions, good_raw, still_counts, write_csv, write_raw
from tests.six_pose import made
from tests.six_pose.made import UP

MANY = 5
SAMPLES = Path(__file__).resolve().parent.parent.parent / "sample_data"


@dataclass(frozen=True)
class Scenario:
    """A command and its inputs.

    Attributes:
        words: names in them are below the folder in which it runs.
        make: makes the inputs, in `in` and, of earlier results, in `out`.
        code: how it ends undisturbed.
        forks: whether it starts processes, which takes longer.
        quick: whether these are forked from the command itself, and not from a server.
        again: what a rerun is told besides, over outputs of which some are there.
        parts: whether a part of the recording that the disk does not give costs itself alone.
        most: how many calls of each operation are made to fail at most, where a run takes seconds.
        rows: where a watch writes its rows; a rerun writes another file (`growing.py`).
    """

    name: str
    words: tuple[str, ...]
    make: Callable[[Path], object]
    code: int = 0
    forks: bool = False
    quick: bool = False
    again: tuple[str, ...] = ()
    parts: bool = False
    most: int | None = None
    rows: str = ""

    @property
    def command(self) -> str:
        """The first word of its name."""
        return re.split("[ ,]", self.name)[0]


def _recording(folder: Path) -> None:
    good_raw(folder / "in")


def _long(folder: Path) -> None:
    """A recording of three row groups, which threads encode."""
    write_raw(folder / "in" / "good.raw", still_counts(np.tile(directions(60), (28, 1))))


def _earlier(folder: Path) -> None:
    """Results of other settings, which are replaced."""
    good_raw(folder / "in")
    _calibrated(folder, "--model", "9", "--prior", "none", "-d", "out", "--html", "--integers")


def _results(folder: Path) -> None:
    """A result beside its recording."""
    good_raw(folder / "in")
    _calibrated(folder, "--windows", "in/windows.parquet")


def _calibrated(folder: Path, *words: str) -> None:
    assert run_in(folder, "calibrate", "in/good.raw", "-q", *words).code == 0


def _archive(folder: Path) -> None:
    """Two tables of half an hour, one after the other."""
    counts, rows = still_counts(directions(60)), 22500
    table = write_csv(folder / "in" / "whole.csv", counts).read_text().splitlines(keepends=True)
    with tarfile.open(folder / "in" / "parts.tar.gz", "w:gz") as archive:
        for number, part in enumerate((table[1 : rows + 1], table[rows + 1 :])):
            path = folder / "in" / f"{number}.csv"
            path.write_text("".join([table[0], *part]))
            archive.add(path, path.name)
            path.unlink()
    (folder / "in" / "whole.csv").unlink()


def _refused(folder: Path) -> None:
    """A recording with too few orientations."""
    write_raw(folder / "in" / "good.raw", still_counts(directions(1)))


def _no_longer_good(folder: Path) -> None:
    """Results of a recording of which too few orientations are left."""
    good_raw(folder / "in")
    _calibrated(folder, "-d", "out", "--html", "--integers")
    _refused(folder)


def _several(folder: Path) -> None:
    """Results of three recordings."""
    _folder(folder)
    paths = sorted(path.relative_to(folder).as_posix() for path in folder.glob("in/*/*.raw"))
    assert run_in(folder, "calibrate", *paths, "-q", "--report-only", "-d", "in").code == 0


def _folder(folder: Path) -> None:
    """Three recordings."""
    for number, poses in enumerate((60, 62, 64)):
        place = folder / "in" / "ab"[number // 2]
        place.mkdir(exist_ok=True)
        write_raw(place / f"p{number}.raw", still_counts(directions(poses), seed=number + 1))


def _six_faces(folder: Path) -> None:
    shutil.copy(SAMPLES / "six_faces.csv.gz", folder / "in" / "six.csv.gz")


def _grown(folder: Path) -> None:
    """A recording whose first MiB rests in one posture: a watch of it takes steps."""
    first, more = directions(200)[:1], directions(200)[:90]
    write_raw(folder / "in" / "good.raw", still_counts(np.concatenate([np.repeat(first, 225, 0), more])))


def _faces(folder: Path) -> None:
    """A session of a file for each face, and the list of what they show."""
    (folder / "in" / "faces").mkdir()
    for number, face in enumerate(UP):
        made.write_csv(folder / "in" / "faces" / f"{number}.csv", made.session([face], 6, seed=number + 1))
    lines = [f"{number}.csv,{','.join(map(str, up))}" for number, up in enumerate(UP.values())]
    made.write_list(folder / "in" / "faces" / "poses.csv", lines, "file,ax,ay,az")


def _nights(folder: Path) -> None:
    """A recording of two files, one after the other."""
    (folder / "in" / "parts").mkdir()
    counts = still_counts(directions(60))
    for number, part in enumerate((counts[:22500], counts[22500:])):
        write_raw(folder / "in" / "parts" / f"{number}.raw", part)
    later = folder / "in" / "parts" / "1.layout.toml"
    later.write_text(later.read_text().replace("00:00:00", "00:15:00"))


def _study(folder: Path, *words: str, out: str = "out") -> None:
    assert run_in(folder, "study", "in", "-d", out, "-j", "1", "-q", *words).code == 0


def _studied(folder: Path) -> None:
    """A study of three recordings."""
    _folder(folder)
    _study(folder)


def _elsewhere(folder: Path) -> None:
    """The same, among the inputs."""
    _folder(folder)
    _study(folder, out="in/results")


def _sharded(folder: Path) -> None:
    """Both parts of a study of three recordings."""
    _folder(folder)
    for part in (1, 2):
        _study(folder, "--shard", f"{part}/2")


def _nothing(_folder: Path) -> None:
    """No inputs."""


def _simulation(form: str) -> Scenario:
    words = ("simulate", "out/sim", "--format", form, "--days", "0.02", "--rate", "50", "-q")
    return Scenario(f"simulate {form}", words, _nothing, again=("--force",))


def _export(form: str, output: str, result: str = "in/good.calibrated.parquet") -> Scenario:
    words = ("export", result, "--to", form, "-o", output, "-q")
    return Scenario(f"export {form}", words, _results, again=("--force",))


def _watch(name: str, make: Callable[[Path], object], rows: str, most: int) -> Scenario:
    words = ("watch", "in/good.raw", "--profile", "paper", "-o", f"out/{rows}")
    return Scenario(name, words, make, again=("-o", f"out/more{Path(rows).suffix}"), rows=rows, most=most)


CALIBRATE = (
    "calibrate", "in/good.raw", "-d", "out", "--html", "--integers", "--windows", "out/w.parquet", "-q"
)  # fmt: skip
REPORT = "in/good.calibration.json"
SESSION = (
    "six-pose", *(f"in/faces/{number}.csv" for number in range(6)),
    "--poses", "in/faces/poses.csv", "-d", "out", "-q",
)  # fmt: skip
STUDY = ("study", "in", "-d", "out", "-j", "2", "-q")
SEVERAL = tuple(f"in/p{number}.calibration.json" for number in range(3))
SCENARIOS = (
    Scenario("calibrate", CALIBRATE, _recording),
    Scenario("calibrate long", ("calibrate", "in/good.raw", "-d", "out", "-q"), _long, most=MANY),
    Scenario("calibrate again", CALIBRATE, _earlier),
    Scenario(
        "calibrate parts",
        ("calibrate", "--parts", "in/parts.tar.gz", "-d", "out", "-q"),
        _archive,
        parts=True,
        most=24,
    ),
    Scenario(
        "calibrate refused", ("calibrate", "in/good.raw", "-d", "out", "--keep-refused", "-q"), _refused, 4
    ),
    Scenario(
        "calibrate, now refused",
        ("calibrate", "in/good.raw", "-d", "out", "-q", "--html", "--integers"),
        _no_longer_good,
        4,
    ),
    Scenario(
        "calibrate folder",
        ("calibrate", "--parts", "in/parts", "-d", "out", "--effect", "--windows", "out/w.csv", "-q"),
        _nights,
        parts=True,
        most=MANY,
    ),
    Scenario("apply", ("apply", "in/good.raw", "--coefficients", REPORT, "-d", "out", "-q"), _results),
    Scenario("fit", ("fit", "in/windows.parquet", "-o", "out/fit.json"), _results),
    Scenario("six-pose", ("six-pose", "in/six.csv.gz", "-d", "out", "-q"), _six_faces),
    Scenario("six-pose folder", ("six-pose", "in/faces", "-d", "out", "-q"), _faces, most=MANY),
    Scenario("six-pose list", SESSION, _faces, most=MANY),
    Scenario("report", ("report", REPORT, "-d", "out", "-q"), _results),
    Scenario("report study", ("report", "out", "-q"), _studied, most=MANY),
    _export("ggir", "out/ggir.csv", REPORT),
    Scenario(
        "export several",
        ("export", *SEVERAL, "--to", "json", "-o", "out/all.jsonl", "-q"),
        _several,
        again=("--force",),
    ),
    _export("csv", "out/good.csv"),
    _export("npz", "out/good.npz"),
    _export("parquet", "out/good.parquet"),
    _export("mhealth", "out/good.csv"),
    _export("bids", "out/sub-1_task-rest_tracksys-imu_motion.tsv"),
    *(_simulation(form) for form in ("flash", "csv", "hdf5", "gt3x")),
    Scenario("inspect", ("inspect", "in/good.raw", "--full"), _recording),
    Scenario("devices", ("devices", "in/results", "-q"), _elsewhere),
    Scenario("verify", ("verify", REPORT, "in/good.raw", "--values", "-q"), _results),
    _watch("watch", _grown, "rows.csv", MANY),
    _watch("watch, arrow", _grown, "rows.arrows", MANY),
    _watch("watch, the beginning", _recording, "rows.arrows", 12),
    Scenario("study", STUDY, _folder, forks=True, most=MANY),
    *(
        Scenario(f"study {word[2:]}", (*STUDY, word, *more), make, forks=True, quick=True, most=MANY)
        for make, word, *more in (
            (_folder, "--html", "--integers"),
            (_folder, "--shard", "1/2"),
            (_sharded, "--collect"),
        )
    ),
)

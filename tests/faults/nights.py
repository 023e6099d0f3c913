"""A study of a lab through many nights: each night must end as a fresh study of the same files.

`python -m tests.faults.nights [NIGHTS [RECORDINGS]]` prints what happened in each. Between nights recordings
come, are replaced, renamed, copied or deleted. In some the disk is full, the run is killed, a folder cannot
be read, or the version has changed.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from tests.cli.studies import change_ledger, texts_of
from tests.faults.checks import Contents, contents, differences
from tests.faults.shim import NONE, Fault, Runner, Struck, running
from tests.recordings import directions, still_counts, write_csv, write_raw

SITES = ("north", "south", "west/clinic")
WORDS = ("-j", "2", "-q", "--recalibrate", "never", "--prior", "none", "--model", "6")
REPORT = ".calibration.json"
MIXED = re.compile(r"\d+( Parquet files?| \(see time_zone)")
ENDS = (".raw", ".csv", ".zip", ".cwa")
"""Suffixes of recordings, those that `Lab` makes."""


@dataclass
class Lab:
    """The recordings of a lab, and what its people do with them.

    Attributes:
        folder: holds `in` and, after the first night, `out`.
        paths: of the recordings there are.
    """

    folder: Path
    chance: random.Random
    paths: list[Path] = field(default_factory=list)
    made: int = 0

    def __post_init__(self) -> None:
        """Folders that hold something besides recordings, so that none is taken for a disk that is away."""
        for site in SITES:
            (self.folder / "in" / site).mkdir(parents=True)
            (self.folder / "in" / site / "notes.txt").write_text(f"recorded at {site}\n")
        (self.folder / "in" / "study.toml").write_text('["south/*"]\ntimezone = "Europe/London"\n')
        (self.folder / "tmp").mkdir()

    def _new(self, path: Path) -> None:
        """Write a recording: one in eight is refused, and one in sixteen is none that can be read."""
        self.made += 1
        kind = self.made % 16
        counts = still_counts(directions(2 if kind in (3, 11) else 12), seed=self.made)[: 9000 + self.made]
        if path.suffix == ".cwa" or (kind == 7 and path.suffix == ".raw"):
            write_raw(path, counts)
            path.write_bytes(bytes(4096))
        elif path.suffix == ".raw":
            write_raw(path, counts)
        else:
            table = write_csv(path.with_suffix(".csv"), counts)
            if path.suffix == ".zip":
                with zipfile.ZipFile(path, "w") as archive:
                    archive.write(table, table.name)
                table.unlink()

    def _remove(self, path: Path) -> None:
        path.unlink()
        path.with_name(f"{path.stem}.layout.toml").unlink(missing_ok=True)

    def add(self) -> None:
        """A new recording."""
        suffix = self.chance.choice((".raw",) * 9 + (".csv", ".zip", ".cwa"))
        site = self.chance.choice(SITES)
        path = self.folder / "in" / site / f"p{self.made:04d}{suffix}"
        self._new(path)
        self.paths.append(path)

    def add_some(self) -> None:
        """A few new recordings."""
        for _ in range(self.chance.randint(1, 4)):
            self.add()

    def replace(self) -> None:
        """Another recording under the same name."""
        self._new(self.chance.choice(self.paths))

    def replace_by_other_suffix(self) -> None:
        """Another recording under the same stem, of another kind."""
        path = self._any()
        self._remove(path)
        other = self.chance.choice([one for one in ENDS if one != path.suffix])
        self.paths[self.paths.index(path)] = new = path.with_suffix(other)
        self._new(new)

    def rename(self) -> None:
        """The same recording under another name, in another folder or the same."""
        path = self._any()
        self.made += 1
        target = self.folder / "in" / self.chance.choice(SITES) / f"r{self.made:04d}{path.suffix}"
        path.rename(target)
        if (layout := path.with_name(f"{path.stem}.layout.toml")).exists():
            layout.rename(target.with_name(f"{target.stem}.layout.toml"))
        self.paths[self.paths.index(path)] = target

    def delete(self) -> None:
        """A person withdraws."""
        if len(self.paths) > 4:
            path = self._any()
            self._remove(path)
            self.paths.remove(path)

    def copy(self) -> None:
        """The same bytes under another name."""
        path = self._any()
        self.made += 1
        target = path.with_name(f"c{self.made:04d}{path.suffix}")
        shutil.copyfile(path, target)
        if (layout := path.with_name(f"{path.stem}.layout.toml")).exists():
            shutil.copyfile(layout, target.with_name(f"{target.stem}.layout.toml"))
        self.paths.append(target)

    def touch(self) -> None:
        """Restored from a backup: new times, the same bytes."""
        os.utime(self._any())

    def edit_options(self) -> None:
        """Options that files state change."""
        zone = self.chance.choice(("Europe/London", "UTC", "Asia/Tokyo"))
        rule = f'["{self.chance.choice(SITES)}/*"]\ntimezone = "{zone}"\n'
        (self.folder / "in" / "study.toml").write_text(rule)

    def lose_output(self) -> None:
        """Somebody tidies up in OUT."""
        if found := sorted((self.folder / "out").rglob("*.parquet")):
            self.chance.choice(found).unlink()

    def lose_ledger(self) -> None:
        """The memory of the study is gone."""
        (self.folder / "out" / "study.ledger").unlink(missing_ok=True)

    def nothing(self) -> None:
        """A quiet night."""

    def _any(self) -> Path:
        return self.chance.choice(self.paths)


def as_if_made_by_an_earlier_version(out: Path) -> None:
    """Ledger, summary and reports say that another version made them, with coefficients a bit off."""

    def change(entry: dict[str, Any]) -> None:
        if entry["row"]:
            entry["asked"] = "0" * 16
            entry["row"]["accelcal_version"] = "0.0.9"

    change_ledger(out, change)
    for path in (out / "study.json", *out.rglob(f"*{REPORT}")):
        about = json.loads(path.read_text())
        for part in (about, about.get("provenance", {})):
            if "accelcal_version" in part:
                part["accelcal_version"] = "0.0.9"
        path.write_text(json.dumps(about))


Event = Callable[[Lab], None]
ORDINARY = (
    Lab.add_some, Lab.replace, Lab.replace_by_other_suffix, Lab.rename, Lab.delete, Lab.copy, Lab.touch,
    Lab.edit_options, Lab.lose_output, Lab.lose_ledger,
)  # fmt: skip
DISTURBED = ("killed", "full", "unreadable", "upgrade")


@dataclass
class Nights:
    """A study that runs every night.

    Attributes:
        fresh: lines of mail of a fresh study of the last night that went well.
        mails: lines of mail since then.
        left, maybe_left: the same for results whose recording is gone, of the study itself.
        there: paths in its table on that night.
        well: whether the last night went well; log: what happened in each.
    """

    lab: Lab
    runner: Runner
    words: tuple[str, ...] = ()
    fresh: set[str] = field(default_factory=set)
    mails: set[str] = field(default_factory=set)
    left: set[str] = field(default_factory=set)
    maybe_left: set[str] = field(default_factory=set)
    there: set[str] = field(default_factory=set)
    log: list[str] = field(default_factory=list)
    well: bool = False

    def night(self, happened: Sequence[Event], disturbed: str = "", *, prune: bool = False) -> None:
        """What happened by day, and the run of the night, which must be as a fresh one (AssertionError)."""
        for one in happened:
            one(self.lab)
        self.log.append(", ".join([*(one.__name__ for one in happened), disturbed, "prune" * prune]))
        if disturbed == "upgrade":
            as_if_made_by_an_earlier_version(self.lab.folder / "out")
        elif disturbed:
            self.well = False
            return self._disturbed(disturbed)
        ran = self._run("out", *(("--prune",) if prune else ()))
        self._compare(ran, prune=prune, quiet=[*happened] == [Lab.nothing])
        return None

    def _run(self, out: str, *more: str, fault: Fault = NONE) -> Struck:
        return self.runner.run(("study", "in", "-d", out, *WORDS, *self.words, *more), self.lab.folder, fault)

    def _fresh(self, fault: Fault = NONE) -> tuple[Struck, Contents]:
        shutil.rmtree(self.lab.folder / "fresh", ignore_errors=True)
        ran = self._run("fresh", fault=fault)
        return ran, contents(self.lab.folder / "fresh")

    def _disturbed(self, how: str) -> None:
        """A night that does not go well: no bug, nothing torn; the next one must be as if it had."""
        chance = self.lab.chance
        if how == "unreadable":
            return self._unreadable(Fault("list", "EACCES", 1, on=True, below=f"in/{chance.choice(SITES)}"))
        nth = chance.randint(1, 60)
        full = Fault("write", "ENOSPC", nth, on=True)
        fault = Fault("open", nth=nth * 5, kills=True) if how == "killed" else full
        struck = self._run("out", fault=fault)
        assert "bug in accelcal" not in struck.ran.err and struck.ran.code not in (70, 71), struck
        self.mails |= set(lines(struck))
        self.maybe_left |= set(of_left(struck))
        return None

    def _unreadable(self, fault: Fault) -> None:
        """A folder that cannot be read costs itself: the table says so, and its outputs stay."""
        before = contents(self.lab.folder / "out")
        struck, (other, fresh) = self._run("out", fault=fault), self._fresh(fault)
        assert struck.ran.code in (0, 1, 3, 4) and "bug in accelcal" not in struck.ran.err, struck
        assert lines(struck) and set(lines(struck)) <= set(lines(other)), (struck, other)
        found = contents(self.lab.folder / "out")
        assert table(found) == table(fresh)
        hidden = {name for name in before if name.startswith(fault.below.removeprefix("in/"))}
        assert hidden <= found.keys(), f"{sorted(hidden - found.keys())} were removed"
        self.mails |= set(lines(struck))
        self.maybe_left |= set(of_left(struck))

    def _compare(self, ran: Struck, *, prune: bool, quiet: bool) -> None:
        """Table, outputs and mail are those of a fresh study of the same files."""
        other, fresh = self._fresh()
        found = contents(self.lab.folder / "out")
        told = f"night {len(self.log)} ({self.log[-1]}):"
        assert ran.ran.code in (0, 1, 3, 4), f"{told} {ran}"
        left = sorted(name for name in found if name.endswith(REPORT) and name not in fresh)
        folders = away(found)
        gone = [name for name in left if name.rpartition("/")[0] not in folders]
        named = orphans(found)
        assert {*([] if prune else gone)} <= {*named} <= {*left}, f"{told} orphans {named}, not {gone}"
        assert not (prune and gone), f"{told} {gone} were not removed"
        there = {row["path"] for row in table(found)}
        assert not {path for path in there & self.there if path.rpartition("/")[0] in folders}, told
        self._compare_findings(ran, found, told)
        self.there = there
        stems = tuple(name.removesuffix(REPORT) + "." for name in left)
        found = {name: held for name, held in found.items() if not (stems and name.startswith(stems))}
        wrong = differences(without_orphans(found), without_orphans(fresh))
        assert not wrong, f"{told} {sorted(wrong)} differ; {ran}"
        mail, should = set(lines(ran)), set(lines(other))
        assert mail <= should, f"{told} mail says what a fresh study does not: {sorted(mail - should)}"
        new = should - self.fresh - self.mails
        assert new <= mail, f"{told} mail lacks {sorted(new - mail)}"
        assert not (quiet and self.well and mail), f"{told} mail in a quiet night: {sorted(mail)}"
        self.fresh, self.mails, self.well = should, set(), True

    def _compare_findings(self, ran: Struck, found: Contents, told: str) -> None:
        """What is left of recordings that are gone is said once; a fresh study has nothing of it."""
        said, now = set(of_left(ran)), findings(found)
        assert said <= now, f"{told} {sorted(said - now)} is not in study.json"
        missing = now - self.left - self.maybe_left - said
        assert not missing, f"{told} mail lacks {sorted(missing)}"
        assert not (self.well and said & self.left), f"{told} {sorted(said & self.left)} is said again"
        self.left, self.maybe_left = now, set()


LEFT = ("stays, and --prune removes it: ", "No recording of the last run is left in this folder")
"""Parts of the lines about results whose recording is gone."""


def is_of_left(line: str) -> bool:
    return any(part in line for part in LEFT)


def of_left(struck: Struck) -> list[str]:
    return [line.removeprefix("accelcal: ") for line in struck.ran.err.splitlines() if is_of_left(line)]


def findings(found: Contents) -> set[str]:
    """The lines about results whose recording is gone, as the summary has them."""
    about: Any = found["study.json"]
    return {one["message"] for one in about["findings"]["listed"] if is_of_left(one["message"])}


def away(found: Contents) -> set[str]:
    """Folders whose disk may be away: no recording of an earlier night is in them."""
    texts = {line.partition(": ")[0] for line in findings(found) if LEFT[1] in line}
    return {"" if one.rpartition("/")[2] == "in" else one for one in texts}


def lines(struck: Struck) -> list[str]:
    """The lines that cron would mail, whatever the output folder and the number of files of mixed times.

    Those about results whose recording is gone are not among them.
    """
    text = (struck.ran.out + struck.ran.err).replace("fresh/", "out/")
    return [MIXED.sub("some", one) for one in text.splitlines() if not is_of_left(one)]


def table(found: Contents) -> list[dict[str, str]]:
    """The rows of the table."""
    held: Any = found["study.parquet"]
    return texts_of(pq.read_table(io.BytesIO(held)))


def orphans(found: Contents) -> list[str]:
    """Results whose recording is gone, as the summary names them."""
    about: Any = found["study.json"]
    return sorted(one["report"] for one in about["orphans"])


def without_orphans(found: Contents) -> Contents:
    """What is compared: the names of what is left over are looked at apart."""
    about: Any = found["study.json"]
    kept = {name: held for name, held in about.items() if name not in ("orphans", "not_listed")}
    kept["findings"] = [one for one in about["findings"]["listed"] if not is_of_left(one["message"])]
    return {**found, "study.json": kept}


def year(one: Nights, nights: int, recordings: int) -> Iterator[str]:
    """So many nights; every disturbance comes, and every third night is quiet. Yield what happened."""
    chance = one.lab.chance
    for _ in range(recordings):
        one.lab.add()
    for number in range(nights):
        if number % 3 == 2:
            one.night((Lab.nothing,))
        elif number % 6 == 4:
            what = DISTURBED[number // 6 % len(DISTURBED)]
            one.night((chance.choice(ORDINARY),), what)
        else:
            happened = chance.sample(ORDINARY, chance.randint(1, 3))
            one.night(tuple(happened), prune=number % 6 == 3)
        yield f"{number + 1}: {one.log[-1]}; {len(one.lab.paths)} recordings"


def main(words: list[str]) -> None:
    """A year, or as many nights as are given."""
    nights, recordings = int([*words, 60][0]), int([*words[1:], 200][0])
    seed = int(os.environ.get("ACCELCAL_NIGHTS_SEED", time.time_ns() % 1_000_000))
    sys.stdout.write(f"ACCELCAL_NIGHTS_SEED={seed}\n")
    with tempfile.TemporaryDirectory() as name, running(Path(name) / "shim", forked=True) as runner:
        assert runner is not None, "needs Linux and a C compiler"
        one = Nights(Lab(Path(name) / "lab", random.Random(seed)), runner)
        for line in year(one, nights, recordings):
            sys.stdout.write(f"{line}, {time.process_time():.0f} s\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])

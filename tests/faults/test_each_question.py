"""Each question to the file system fails in turn, in discovery, planning and workers: a row, or a note."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.studies import rows
from tests.faults.checks import contents
from tests.faults.shim import Fault, Runner, Struck
from tests.recordings import directions, still_counts, write_csv, write_raw

ERRORS = ("EACCES", "ENAMETOOLONG", "ELOOP", "EIO", "ESTALE")
ASKED = ("stat", "open", "list", "read")
WORDS = ("study", "in", "-d", "out", "-j", "2", "--recalibrate", "never", "--prior", "none", "--model", "6")
NAMES = ("a/p0.raw", "b/p1.zip", "b/p2.csv", "b/p3.raw")


def make(folder: Path) -> None:
    """Recordings with what discovery and workers look at: a layout, options, an archive, a link."""
    for name in ("a", "b"):
        (folder / "in" / name).mkdir(parents=True)
    write_raw(folder / "in" / "a" / "p0.raw", still_counts(directions(24)))
    (folder / "in" / "a" / "p0.toml").write_text('timezone = "UTC"\n')
    packed = write_csv(folder / "in" / "b" / "p1.csv", still_counts(directions(24), seed=2))
    with zipfile.ZipFile(folder / "in" / "b" / "p1.zip", "w") as archive:
        archive.write(packed, packed.name)
    packed.rename(folder / "in" / "b" / "p2.csv")
    write_raw(folder / "in" / "b" / "p3.raw", still_counts(directions(2), seed=3))
    (folder / "in" / "study.toml").write_text('["a/*.raw"]\nshift = 1.0\n')
    (folder / "in" / "link").symlink_to("a", target_is_directory=True)
    for name in ("out", "tmp"):
        (folder / name).mkdir()


class Asking:
    """A study that is run again and again, each time as if for the first time."""

    def __init__(self, folder: Path, runner: Runner) -> None:
        self.folder, self.runner = folder, runner
        make(folder)
        self.whole = self._run(Fault("open"))
        self.undisturbed = contents(folder / "out")
        assert [row["path"] for row in rows(folder / "out")] == [*NAMES]

    def _run(self, fault: Fault) -> Struck:
        for name in ("out", "tmp"):
            for path in sorted((self.folder / name).rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
        return self.runner.run(WORDS, self.folder, fault)

    def wrong(self, fault: Fault) -> Iterator[str]:
        """What is not as it must be where this call fails."""
        struck = self._run(fault)
        ran, told = struck.ran, f"{fault} at {struck.place}: {{}}\n{struck.ran}"
        if ran.code not in (0, 1, 2, 3, 4, 5) or "bug" in ran.err or "Traceback" in ran.err:
            yield told.format("told as a bug")
        elif ran.code not in (2, 5):
            table = rows(self.folder / "out")
            known = {row["path"] for row in table}  # of a folder that cannot be listed, its own
            missing = [name for name in NAMES if not {name, name[:1], "."} & known and name not in ran.err]
            if missing:
                yield told.format(f"{missing} are neither in the table nor told of")
            elif any("bug" in row["message"] for row in table):
                yield told.format("the table has a bug")
            elif ran.err == self.whole.ran.err and not _absent(fault) and self._differs():
                yield told.format(f"{self._differs()} differ in silence")

    def _differs(self) -> list[str]:
        found = contents(self.folder / "out")
        names = found.keys() | self.undisturbed.keys()
        names -= {"study.lock"}  # the next run sees that its process is gone
        return sorted(name for name in names if found.get(name) != self.undisturbed.get(name))


def _absent(fault: Fault) -> bool:
    """Whether the answer means that nothing of that name can be there, as of a layout that is not there."""
    return fault.operation == "stat" and fault.error in ("ENAMETOOLONG", "ELOOP")


@pytest.mark.parametrize("kind", ASKED)
def test_h1_a_fault_in_a_study_costs_a_row_or_a_note(quick_runner: Runner, tmp_path: Path, kind: str) -> None:
    """A question for each error, spread over all."""
    asking = Asking(tmp_path, quick_runner)
    step = asking.whole.calls[kind] // len(ERRORS)
    assert not [
        one
        for number, error in enumerate(ERRORS)
        for one in asking.wrong(Fault(kind, error, 1 + number * step))
    ]


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ASKED)
@pytest.mark.parametrize("error", ERRORS)
def test_h1_any_question_that_fails_in_a_study_costs_a_row_or_a_note(
    quick_runner: Runner, tmp_path: Path, kind: str, error: str
) -> None:
    asking = Asking(tmp_path, quick_runner)
    calls = range(1, asking.whole.calls[kind] + 1)
    wrong = [one for nth in calls for one in asking.wrong(Fault(kind, error, nth))]
    assert not wrong, f"{len(wrong)} of {len(calls)}\n" + "\n".join(wrong)

"""A few mutants of every target; `make fuzz` tries many more. And what the fuzzer itself must notice."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.recording import Problem
from tests.fuzz import __main__ as fuzz_main
from tests.fuzz import command, engine, limits, mutate_cwa, reading
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Rows, Truth, verdict

FEW, MANY = range(1, 10), range(100, 700)
"""The first numbers of each target are tried in the fast tests, through no command; then many."""

LATE = {"gt3x": 50, "csv": 30}
"""Formats whose first mutants lose nothing."""

REFUSED = {
    **{"cwa": 0.07, "parmay": 0.09, "genea": 0.12, "geneactiv": 0.15, "flash": 0.19, "gt3x": 0.22},
    **{"feather": 0.30, "mat": 0.32, "csv": 0.33, "edf": 0.33, "raw": 0.36, "wav": 0.40, "npz": 0.42},
    **{"opal": 0.43, "parquet": 0.49, "embraceplus": 0.57, "hdf5": 0.61, "unisens": 0.66},
}
"""Upper bounds of the shares of mutants that are refused, as a reader must not give up too early."""

CWA_REFUSALS = {"holds no intact data sector", "is not an Axivity .cwa recording", "the file is empty"}

SLOWEST = {"points", "poses", "reports", "studies", "remembered", "options"}
NIGHTLY = {"reports", "studies", "remembered"}


@pytest.fixture(autouse=True)
def _patient(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "FAILURES", tmp_path / "failures")
    monkeypatch.setattr(limits, "SECONDS", 60.0)
    monkeypatch.setattr(limits, "CPU_SECONDS", 60.0)


@pytest.mark.parametrize("name", [name for name in engine.NAMES if name not in NIGHTLY])
def test_damaged_files_give_true_rows_or_errors_of_ours(name: str, tmp_path: Path) -> None:
    numbers = FEW[:3] if name in SLOWEST else FEW
    assert engine.fuzz(name, 1, numbers, tmp_path).failures == []


@pytest.mark.nightly
@pytest.mark.parametrize("name", engine.NAMES)
def test_many_damaged_files(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "OTHER_CHUNKS_EACH", 2)
    found = engine.fuzz(name, 1, MANY[:60] if name in SLOWEST else MANY, tmp_path)
    assert found.failures == []
    assert found.refused < REFUSED.get(name, 2.0) * found.mutants
    if name == "cwa":
        assert {text.partition(" (")[0] for text in found.refusals} <= CWA_REFUSALS


@pytest.mark.parametrize("name", engine.FORMATS)
def test_a_number_makes_the_same_mutant_in_any_process(name: str) -> None:
    module = __import__(f"tests.fuzz.mutate_{name}", fromlist=["mutant"])
    one, two = (module.mutant(Random(f"{name} 1 5")) for _ in range(2))
    assert (one.what, len(one.data)) == (two.what, len(two.data))


ROWS = np.arange(30).reshape(10, 3) / 256
WHOLE = Truth(ROWS, ROWS)


def test_rows_as_they_are_pass() -> None:
    assert verdict(Rows(ROWS, False), WHOLE) == (None, 0)
    assert verdict(Rows(ROWS[2:], True), WHOLE) == (None, 2)


@pytest.mark.parametrize(
    ("given", "told", "truth", "kind"),
    [
        (np.vstack([ROWS, [[9, 9, 9]]]), True, WHOLE, "INVENTED"),
        (np.vstack([ROWS, ROWS[:1]]), True, WHOLE, "INVENTED"),
        (ROWS + 1 / 256, True, WHOLE, "INVENTED"),
        (ROWS[1:], False, WHOLE, "SILENTLY LOST"),
        (ROWS, False, Truth(ROWS, ROWS, damaged=1), "SILENTLY LOST"),
        (ROWS[::-1], True, WHOLE, "ORDER"),
    ],
)
def test_what_is_wrong_with_rows_is_found(given: np.ndarray, told: bool, truth: Truth, kind: str) -> None:
    assert str(verdict(Rows(given, told), truth)[0]).startswith(kind)


def test_a_reader_that_believes_wrong_checksums_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole way from the mutant to the failure."""
    numbers = range(1, 40)
    monkeypatch.setattr(
        "accelcal_cli.formats.cwa.sector.checksums", lambda pages: np.zeros(len(pages), np.uint16)
    )
    found = engine.fuzz("cwa", 1, numbers, tmp_path).failures
    assert any("INVENTED" in failure for failure in found)


@pytest.mark.parametrize("name", ["cwa", "flash", "geneactiv", "gt3x", "csv"])
def test_a_reader_that_keeps_problems_back_is_found(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows_of = reading.gathered
    monkeypatch.setattr(reading, "gathered", lambda *told: Rows(rows_of(*told).values, False))
    found = engine.fuzz(name, 1, range(1, LATE.get(name, 10)), tmp_path).failures
    assert any("SILENTLY LOST" in failure for failure in found)


def test_hangs_memory_and_errors_of_the_reader_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "SECONDS", 0.01)

    def endless(*_: Any, **__: Any) -> None:
        while True:
            pass

    for odd, kind in ((endless, "HANGS"), (lambda *_, **__: 1 / 0, "ZeroDivisionError")):
        monkeypatch.setattr(engine, "read", odd)
        assert kind in engine.fuzz("flash", 1, range(1, 2), tmp_path).failures[0]
    monkeypatch.setattr(limits, "MEMORY_BYTES", -1)
    monkeypatch.setattr(engine, "read", lambda *_, **__: bytearray(1 << 26) and Rows(np.empty((0, 3)), True))
    failure = engine.fuzz("flash", 1, range(1, 2), tmp_path).failures[0]
    assert "MEMORY" in failure or "HANGS" in failure


@pytest.mark.parametrize(
    ("shown", "said", "code", "kind"),
    [
        ("a\x1b[31m", "", 0, "CONTROL"),
        ("", "accelcal: \x07", 3, "CONTROL"),
        ("", "RuntimeWarning: overflow", 0, "FOREIGN"),
        ("", "", 70, "CODE"),
    ],
)
def test_what_a_command_may_not_do_is_found(shown: str, said: str, code: int, kind: str) -> None:
    assert str(command.wrong(command.Ran(code, shown, said, None))).startswith(kind)
    assert command.wrong(command.Ran(3, "a\tb\n", "accelcal: c\n", None)) is None


def test_outputs_that_are_not_whole_are_found(tmp_path: Path) -> None:
    (tmp_path / ".a.tmp").touch()
    assert str(command.wrong(command.Ran(0, "", "", None), tmp_path)).startswith("LEFT BEHIND")
    (tmp_path / ".a.tmp").rename(tmp_path / "a.parquet")
    assert str(command.wrong(command.Ran(3, "", "accelcal: x\n", None), tmp_path)).startswith("OUTPUTS")


def test_the_oracle_of_problems() -> None:
    reading.check_problem(Problem("checksum", "x", 0, 0))
    with pytest.raises(AssertionError):
        reading.check_problem(Problem("checksum", "x", 0, 0, count=0))


def test_parts_cover_every_mutant_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "MUTANTS", 40_000)
    parts = fuzz_main.parts(list(engine.NAMES))
    found = [part for part in parts if part.name == "cwa"]
    assert len(found) > 1
    wanted = engine.number_of_mutants("cwa", 40_000)
    assert sorted(number for part in found for number in part.numbers) == list(range(wanted))
    later = [part for part in fuzz_main.parts(["cwa"], 10_000) if part.name == "cwa"]
    rest = range(engine.number_of_mutants("cwa", 10_000), wanted)
    assert sorted(number for part in later for number in part.numbers) == list(rest)
    formats = sum(len(part.numbers) for part in parts if part.name in engine.FORMATS)
    assert 40_000 - len(engine.FORMATS) <= formats <= 40_000


def test_the_decoder_of_sectors_agrees_with_the_bytes() -> None:
    head, more, *pages = mutate_cwa.recordings()[0]
    found = mutate_cwa.truth(head + more + b"".join(pages))
    assert np.array_equal(found.sure * 256, mutate_cwa.counts())
    assert found.damaged == 0
    assert blind(head, Random(1)) != head

"""Temperature slopes of `exports/coefficients.py`, in the degrees that each tool makes of raw words.

The oracle decodes .cwa files by the vendor's cwa.h, makes degrees by each tool's own line, and applies each
tool's own formula; the words of two kinds of hardware are written here.
"""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.recording import ThermometerWord
from accelcal_cli.exports.coefficients import biobank, ggir, omconvert, read_exported, temperature_note
from tests.cli.run import exit_code, run
from tests.device_recordings import edit
from tests.exports.test_coefficients import made

SLOPE_MG_PER_C = (1.5, -1.5, 1.5)
LINES = {0x17: (0.15, -20.5), 0xFF: (75 / 256, -50.0), 0x64: (75 / 256, -50.0)}
"""Degrees of a word: ours, by hardware (Docs/ax3/ax3-auxiliary.md and the firmware's profiles)."""

SECTOR = np.dtype([("head", "<u2", 10), ("heat", "<u2"), ("more", "<u2", 4), ("xyz", "<i2", (80, 3)),
                   ("checksum", "<u2")])  # fmt: skip


@cache
def simulated(folder: Path) -> bytes:
    """A recording of hardware 0x17 (12.5 Hz, 1.5 days), whose offsets follow the temperature."""
    slope = [str(value) for value in SLOPE_MG_PER_C]
    arguments = ["--format", "cwa", "--days", "1.5", "--rate", "12.5", "-q", "--temp-slope", *slope]
    assert exit_code("simulate", folder / "a.cwa", *arguments) == 0
    return (folder / "a.cwa").read_bytes()


def of_hardware(data: bytes, hardware: int) -> bytes:
    """The same recording by another kind of hardware: the same temperatures in other words."""
    head, body = bytearray(data[:1024]), np.frombuffer(data[1024:], SECTOR).copy()
    head[4] = hardware
    (old_slope, old_zero), (slope, zero) = LINES[0x17], LINES[hardware]
    body["heat"] = np.rint((body["heat"] * old_slope + old_zero - zero) / slope).astype(np.uint16)
    body["checksum"] = 0
    body["checksum"] = -body.view("<u2").reshape(-1, 256).sum(axis=1, dtype=np.uint16)
    return bytes(head) + body.tobytes()


def still(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Means [g] and words of sectors at rest, of whole ones: 6.4 s each."""
    body = np.frombuffer(data[1024:], SECTOR)
    xyz = body["xyz"] / 256.0
    rest = (xyz.std(axis=1) < 0.013).all(axis=1) & (body["more"][:, 3] == 80)
    assert rest.sum() > 5000
    return xyz[rest].mean(axis=1), body["heat"][rest].astype(float)


def by_ggir(text: str, v: np.ndarray, word: np.ndarray) -> np.ndarray:
    """GGIRread's readAxivity.R and GGIR's g.getmeta.R."""
    row = dict(zip(*csv.reader(io.StringIO(text)), strict=True))
    scale, offset, warmth = (
        np.array([float(row[f"{name}.{axis}"]) for axis in "xyz"])
        for name in ("scale", "offset", "temperature.offset")
    )
    celsius = (word.astype(int) & 0x3FF) * 75.0 / 256.0 - 50
    return (v + offset) * scale + np.outer(celsius - float(row["meantempcal"]), warmth)


def by_biobank(line: str, v: np.ndarray, word: np.ndarray) -> np.ndarray:
    """AxivityReader.java and EpochWriter.java."""
    words = line.split()
    offset, slope, warmth = (
        np.array([float(value) for value in words[words.index(f"--{name}") + 1 :][:3]])
        for name in ("calOffset", "calSlope", "calTemp")
    )
    return offset + v * slope + np.outer((word * 150.0 - 20500) / 1000, warmth)


def by_omconvert(line: str, v: np.ndarray, word: np.ndarray) -> np.ndarray:
    """omconvert.c, both the line of its degrees and its rescaling."""
    values = [float(number) for number in line.split('"')[1].split(",")]
    scale, offset, warmth = (np.array(values[start : start + 3]) for start in (0, 3, 6))
    return (v + offset) * scale + np.outer((word * 150 - 20500) / 1000.0 - values[9], warmth)


def ours(report: dict[str, Any], v: np.ndarray, celsius: np.ndarray) -> np.ndarray:
    """The calibration without misalignment by the report's own numbers: a = K (v + o + s (T - Tref))."""
    found = report["without_misalignment"]["calibration"]
    line = found["temperature"]
    warmth = np.outer(celsius - line["reference_c"], line["slope_g_per_c"])
    return (v + found["offset_g"] + warmth) @ np.array(found["gain"]).T


@pytest.mark.parametrize("hardware", [0x17, 0xFF, 0x64])
def test_p1_slopes_are_in_the_degrees_of_the_tool(
    hardware: int, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data = of_hardware(simulated(tmp_path_factory.getbasetemp()), hardware)
    (tmp_path / "a.cwa").write_bytes(data)
    assert exit_code("calibrate", tmp_path / "a.cwa", "--report-only", "-q") == 0
    path = tmp_path / "a.calibration.json"
    report, one = json.loads(path.read_text()), read_exported(path)
    slope, zero = LINES[hardware]
    assert report["recording"]["thermometer"] == {"celsius_per_count": slope, "celsius_at_zero": zero}
    assert report["without_misalignment"]["calibration"]["model"] == "6T"
    v, word = still(data)
    expected = ours(report, v, word * slope + zero)
    for found in (
        by_ggir(ggir([one]), v, word),
        by_biobank(biobank(one), v, word),
        by_omconvert(omconvert(one), v, word),
    ):
        assert np.abs(found - expected).max() < 1e-9  # asked for: 0.3 mg
    assert np.abs(np.linalg.norm(expected, axis=1) - 1).mean() < 0.01
    assert (expected - v).std() > 0.002, "the temperature matters here"


FORMATS = ("cwa", "geneactiv", "gt3x", "csv", "parmay", "hdf5", "wav", "unisens", "flash")


@pytest.mark.parametrize("name", FORMATS)
def test_p1_a_tool_gets_slopes_only_of_temperatures_that_it_reads(name: str) -> None:
    """Also where it adds a term without a reference: accProcess takes 1.0 for the degrees of a .gt3x file."""
    one = made()
    one = replace(one, recording=replace(one.recording, format=name, thermometer=None))
    reads = {"ggir": ("geneactiv", "csv", "unisens"), "biobank": ("geneactiv",), "omconvert": ()}
    for tool, formats in reads.items():
        axes, note = one.axes(tool), temperature_note(one, tool)
        assert one.uses_temperature(tool) == (name in formats)
        assert (axes.warmth() == (0, 0, 0)) == (name not in formats)
        assert (note is None) == (name in formats)
        assert axes.scale == one.axes("ggir").scale and axes.offset_g == one.axes("ggir").offset_g
    if name == "gt3x":
        assert temperature_note(one, "biobank") == (
            "temperature is left out: accProcess reads no temperature from gt3x files, "
            "or that of another thermometer"
        )
        k, o = (np.array(values) for values in (one.axes("biobank").scale, one.axes("biobank").offset_g))
        words = biobank(one).split()
        assert [float(value) for value in words[words.index("--calOffset") + 1 :][:3]] == (k * o).tolist()


def test_p1_a_report_that_does_not_say_how_the_temperature_was_read(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.cwa").write_bytes(simulated(tmp_path_factory.getbasetemp()))
    assert exit_code("calibrate", tmp_path / "a.cwa", "--report-only", "-q") == 0
    path = edit(tmp_path / "a.calibration.json", lambda report: report["recording"].pop("thermometer"))
    done = run(capsys, "export", path, "--to", "ggir")
    assert "temperature is left out: the report does not say how it was read" in done.err
    row = dict(zip(*csv.reader(io.StringIO(done.out)), strict=True))
    cells = [row[name] for name in ("use.temperature", "temperature.offset.x", "meantempcal")]
    assert cells == ["FALSE", "0.0", "0.0"]


def test_p1_a_device_that_ggir_finds_too_warm() -> None:
    """GGIR uses none if the first ten are above 50 of its degrees, which an AX3 1.7 is at 30.7."""
    one = made()
    warm = ThermometerWord(0.15, -20.5)
    one = replace(one, recording=replace(one.recording, format="cwa", thermometer=warm))
    assert pytest.approx(50) == (30.7 + 20.5) / 0.15 * 75 / 256 - 50
    note = temperature_note(one, "ggir")
    assert note is not None and "reads temperatures around 42.5 from this device" in note
    assert temperature_note(one, "biobank") is None

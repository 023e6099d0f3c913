"""Published faults by `output/advice.py`: each has a source, and concerns only the devices that it names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.recording import Device
from accelcal_cli.output.advice import known_faults, of_device
from tests.cli.run import exit_code
from tests.recordings import directions, still_counts


def test_51_7_each_has_a_public_source() -> None:
    assert known_faults()
    for one in known_faults():
        assert one.source.startswith("https://") and one.name and one.fault and (one.serial or one.model)


@pytest.mark.parametrize(("serial", "firmware", "told"), [
    ("MOS2A01130013", "1.5.0", True), ("MOS2A01130013", "1.9.2", False), ("NEO1F07120358", "1.5.0", False),
    (None, None, False), ("MOS2A01130013", None, False),
])  # fmt: skip
def test_51_7_only_devices_that_it_names(serial: str | None, firmware: str | None, told: bool) -> None:
    found = of_device(Device("wGT3XBT", serial, firmware))
    assert [one.values["name"] for one in found] == (["16CPAN03"] if told else [])


@pytest.mark.parametrize(
    ("model", "firmware", "told"),
    [("AX6", "54", True), ("AX6", "56", False), ("AX3", "51", False), ("AX6", None, False)],
)
def test_51_7_only_models_that_it_names(model: str, firmware: str | None, told: bool) -> None:
    found = of_device(Device(model, "6011834", firmware))
    assert [one.values["name"] for one in found] == (["AX6 firmware 56"] if told else [])


@pytest.mark.parametrize(("firmware", "told"), [("v1.7.0", True), ("v1.9.2", False)])
def test_51_7_the_report_has_it_as_a_caution(firmware: str, told: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    head = (
        f"------------ Data File Created By ActiGraph wGT3XBT ActiLife v6.13.3 Firmware {firmware} date "
        "format M/d/yyyy at 30 Hz  Filter Normal -----------\n"
        "Serial Number: MOS2A01130013\nStart Time 10:00:00\n"
        "Start Date 2/3/2014\nEpoch Period (hh:mm:ss) 00:00:00\nDownload Time 12:00:00\n"
        "Download Date 2/4/2014\nCurrent Memory Address: 0\nCurrent Battery Voltage: 4.1     Mode = 12\n"
        "--------------------------------------------------\n"
        "Accelerometer X,Accelerometer Y,Accelerometer Z\n"
    )
    rows = np.round(still_counts(directions(40)) / 256, 3)
    path.write_text(head + "\n".join(",".join(map(str, row)) for row in rows.tolist()) + "\n")
    assert exit_code("calibrate", path, "--report-only", "-q") == 0
    report = json.loads((tmp_path / "a.calibration.json").read_text())
    codes = [one["code"] for one in report["cautions"]]
    assert ("known_fault" in codes) is told

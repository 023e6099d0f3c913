"""Calls as users write them, for type checkers: each line that ends with `# wrong` is reported, no other.

It is not run.
"""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

import numpy as np

import accelcal

xyz = np.zeros((1000, 3))
RIGHT = accelcal.calibrate("night.cwa")

accelcal.calibrate(Path("night.cwa"), rate=25, unit="g", prior="none")
accelcal.calibrate(xyz, rate=100, start="2024-03-04T00:00:00", unit="m/s2")
accelcal.calibrate(xyz, rate=100.0, start=datetime(2024, 3, 4), temperature=np.zeros(1000))
accelcal.calibrate(xyz.astype(np.int16), rate=50, unit="counts", lsb_per_g=256, gyroscope=xyz)
accelcal.calibrate(b"PK", columns=("x", "y", "z"), timezone="Europe/Berlin")
accelcal.calibrate(io.BytesIO(b""), columns=[1, 2, 3])
accelcal.calibrate("rows.npz", columns="imu/raw", gyro_columns="imu/turns")
accelcal.calibrate([[0.0, 0.0, 1.0]], rate=100)
accelcal.calibrate({"x": [0.0], "y": [0.0], "z": [1.0]}, rate=None)
accelcal.calibrate("night.cwa", profile="paper", stillness_axis="y", max_subset_points=4)
accelcal.calibrate("night.cwa", latitude=52, altitude=40, max_error=5, strict=True)
outcome: str = RIGHT.outcome
error: float | None = RIGHT.calibration_error_mg
gain: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = RIGHT.calibration.gain
values: np.ndarray[tuple[int, ...], np.dtype[np.float32]] = RIGHT.calibration(xyz, 21.5)
page: str = RIGHT.to_html()
RIGHT.write("out", force=True)
RIGHT.plot()
with accelcal.read("night.cwa", chunk_samples=1000, sensor="wrist") as reading:
    lengths: list[int] = [len(piece) for piece in reading]
accelcal.inspect("night.cwa", full=True, stillness="range")["prediction"]
accelcal.fit(xyz, model="9", latitude=52.5)
accelcal.fit(RIGHT.windows()).calibration.slope.sum()
accelcal.from_poses(["a.csv", "b.csv"], roll=["z,80,95"], unchecked=True)
accelcal.apply(RIGHT, [0, 0, 1], temperature=[21.0])
accelcal.apply("night.calibration.json", xyz, first_sample=10)
accelcal.effect("night.cwa", epoch=60, coefficients="night.calibration.json")["effect"]
accelcal.study("in", "out", jobs=1, borrow=True, progress=False, prior="population")
accelcal.study(["a", "b"], Path("out"), executor=ThreadPoolExecutor(2), include=["*.cwa"], prior="device")
accelcal.export([RIGHT, "b.calibration.json"], to="ggir", output="c.csv").upper()
accelcal.report("out").name.upper()
accelcal.verify("a.calibration.json", Path("a.cwa"), values=True)["result"]
accelcal.devices("out", device="123", rules={"drift_mg": 2.0}, registry="devices.json")["devices"]
accelcal.study("in", "out", dry_run=True)["state"].tolist()
accelcal.calibrate(xyz, time=[datetime(2024, 3, 4)] * 1000, name="P001", serial="0042")
accelcal.effect(RIGHT, epoch=60)
accelcal.fit(RIGHT)
RIGHT.to_pandas(local=True)
RIGHT.epochs(60, local=True)
accelcal.simulate("sim.cwa", format="cwa", days=2, temp_slope=(0, 0, 1))[0].exists()

accelcal.nope  # wrong
accelcal.calibrate("night.cwa", rte=25)  # wrong
accelcal.calibrate("night.cwa", prior=3)  # wrong
accelcal.calibrate("night.cwa", prior="device")  # wrong
accelcal.calibrate("night.cwa", unit="kg")  # wrong
accelcal.calibrate("night.cwa", rate="25")  # wrong
accelcal.calibrate("night.cwa", 25)  # wrong
accelcal.calibrate(3)  # wrong
accelcal.calibrate()  # wrong
accelcal.calibrate("night.cwa", columns=("x", "y"))  # wrong
accelcal.calibrate("night.cwa").data  # wrong
accelcal.calibrate("night.cwa").calibration.gian  # wrong
accelcal.Calibration("x.json").fit(xyz)  # wrong
accelcal.read("night.cwa", model="9")  # wrong
accelcal.fit(xyz, rate=25)  # wrong
accelcal.from_poses("faces", prior="none")  # wrong
accelcal.study("in")  # wrong
accelcal.study("in", "out", n_jobs=2)  # wrong
accelcal.export(RIGHT, to="gggir")  # wrong
accelcal.simulate("sim.cwa", day=2)  # wrong

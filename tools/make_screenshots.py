"""Remake docs/recording_page.png and docs/study_page.png: the pages of the sample data, in a real Chromium.

`make screenshots` runs it with the browser that `make browser` sets up.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import accelcal

ROOT = Path(__file__).resolve().parent.parent
NAMES = ("recording.bin", "night.h5", "evening.csv.gz", "six_faces.csv.gz")


def main() -> None:
    """Calibrate, open the pages and save what is seen of them without scrolling."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        recordings, out = Path(folder, "sample_data"), Path(folder, "calibrated")
        recordings.mkdir()
        for name in NAMES:
            shutil.copy(ROOT / "sample_data" / name, recordings / name)
        accelcal.study(recordings, out)
        accelcal.report(out)
        browser = playwright.chromium.launch(
            executable_path=os.environ["ACCELCAL_CHROMIUM"], args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1100, "height": 900}, color_scheme="light")
        for name in ("recording", "study"):
            page.goto((out / f"{name}.html").as_uri())
            page.screenshot(path=ROOT / "docs" / f"{name}_page.png")
        browser.close()


if __name__ == "__main__":
    main()

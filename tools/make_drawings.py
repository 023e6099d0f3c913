"""Remake docs/pipeline.svg, and docs/sphere.svg from the sample recording."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STEPS = (
    ("recording", "any format,", "read in chunks"),
    ("still windows", "5 s without", "movement"),
    ("points", "averaged by", "orientation"),
    ("fit", "nine parameters", "and temperature"),
    ("judgement", "error over all", "orientations"),
    ("samples", "calibrated", "Parquet, report"),
)
STYLE = """
text { font: 13px system-ui, sans-serif; fill: #1b2330; }
.head { font-weight: 600; } .soft { fill: #566072; font-size: 12px; }
.box { fill: #f3f5f8; stroke: #14509e; stroke-width: 1.5; }
.arrow { stroke: #566072; stroke-width: 1.5; fill: none; }
.cell0 { fill: #e6eaf0; stroke: #fff; } .cell1 { fill: #14509e; opacity: .35; stroke: #fff; }
.cell2 { fill: #14509e; opacity: .65; stroke: #fff; } .cell3 { fill: #14509e; stroke: #fff; }
.frame, .grid { stroke: #566072; fill: none; } .mark { stroke: #a81c1c; fill: none; stroke-width: 2; }
.strong { font-weight: 600; } .bad { fill: #a81c1c; font-weight: 600; } .page { fill: #fff; }
"""


def svg(width: int, height: int, about: str, body: str) -> str:
    """Return a drawing that stands alone, on white in light and dark."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{about}">\n<style>{STYLE}</style>\n<rect class="page" width="{width}" '
        f'height="{height}"/>\n{body}\n</svg>\n'
    )


def pipeline() -> str:
    """Return the drawing of the steps from a file to its calibrated samples."""
    parts = []
    for place, (head, *lines) in enumerate(STEPS):
        x = 8 + 150 * place
        parts.append(f'<rect class="box" x="{x}" y="12" width="126" height="76" rx="6"/>')
        parts.append(f'<text class="head" x="{x + 63}" y="36" text-anchor="middle">{head}</text>')
        parts += [
            f'<text class="soft" x="{x + 63}" y="{56 + 17 * row}" text-anchor="middle">{line}</text>'
            for row, line in enumerate(lines)
        ]
        if place:
            parts.append(f'<path class="arrow" d="M{x - 22} 50h18m-6 -5l6 5l-6 5"/>')
    return svg(900, 100, "The steps from a recording to its calibrated samples", "\n".join(parts))


def sphere() -> str:
    """Return the figure of orientations on the page of the sample recording."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["calibrate", str(ROOT / "sample_data/recording.bin"), "-d", folder, "-q", "--html"]
        subprocess.run([sys.executable, "-m", "accelcal_cli", *words], check=True)
        page = Path(folder, "recording.html").read_text("utf-8")
    found = re.search(r'<svg[^>]*aria-labelledby="sphere-title[^>]*>(.*?)</svg>', page, re.DOTALL)
    if found is None:
        raise SystemExit("the page has no figure of orientations")
    body = re.sub(r"<(title|desc)[^>]*>.*?</\1>", "", found[1], flags=re.DOTALL)
    return svg(760, 362, "Orientations in which the device of the sample recording was still", body)


def main() -> None:
    """Draw and save."""
    (ROOT / "docs/pipeline.svg").write_text(pipeline(), "utf-8")
    (ROOT / "docs/sphere.svg").write_text(sphere(), "utf-8")


if __name__ == "__main__":
    main()

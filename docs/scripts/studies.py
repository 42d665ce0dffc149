"""Draws the pictures of docs/studies.md: some of those that the studies write, in fewer colours.

Usage: .venv/bin/python docs/scripts/studies.py [--output docs/img]
"""

import argparse
import io
import time
from pathlib import Path

from PIL import Image

from softplc.commissioning.study import aoi, ducekf

CHOSEN = {"aoi-figure-2", "aoi-methods", "ducekf-figure-2", "ducekf-figure-3", "ducekf-figure-7", "ducekf-covariance"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/img"))
    output = parser.parse_args().output
    for study in (aoi.study(), ducekf.study(time.perf_counter_ns)):
        for picture in study.report.pictures():
            if picture.name in CHOSEN:
                image = Image.open(io.BytesIO(picture.png)).convert("RGB")
                image = image.resize((720, 720 * image.height // image.width), Image.Resampling.LANCZOS)
                image.quantize(40, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
                    output / f"{picture.name}.png", optimize=True
                )


if __name__ == "__main__":
    main()

"""One row, in a process of its own: ``python -m scanhsi.bench.processing.worker ROW LINES BANDS SAMPLES FOLDER``."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np

from scanhsi.bench.processing.rows import ROWS, Given, clean
from scanhsi.bench.processing.work import Size
from scanhsi.bench.storage.work import Peak, memory_mb

FRAMES = "frames.npy"


def main() -> None:
    """Print one JSON object."""
    row, lines, bands, samples, place = sys.argv[1:]
    out = os.dup(1)
    os.dup2(2, 1)  # whatever a library prints is not the result
    folder = Path(place)
    frames = np.load(folder / FRAMES, mmap_mode="r")  # the page cache's memory: rows from disk do not need it
    base_mb = memory_mb()
    given = Given(Size(int(lines), int(bands), int(samples)), frames, folder)
    try:
        with Peak() as peak:
            told = ROWS[row](given)
    finally:
        clean(folder)
    os.write(out, json.dumps({**told, "peak_mb": peak.mb, "base_mb": base_mb}).encode())


if __name__ == "__main__":
    main()

"""Whole scans with simulated devices to disk, small and quick, whose pixels say where the mirror stood."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import scanhsi
from scanhsi import imager
from scanhsi.cube.reader import cube_summary, read_records
from scanhsi.cube.verify import verify_cube
from scanhsi.cube.writer import CubeWriter
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim.scenes.testpattern import decode

LINES_PER_SHARD = 6
OFFSET = (500, 1000)


def small(**changes: Any) -> InstrumentConfig:
    """The paper's instrument with a small picture."""
    roi = {"roi.samples": 40, "roi.bands": 24, "roi.sample_offset": OFFSET[1], "roi.band_offset": OFFSET[0]}
    quick = {"camera.scene": "testpattern", "actuator.home_s": 0.0, "storage.lines_per_shard": LINES_PER_SHARD}
    return load_instrument("sensors2019", {**roi, **quick, **changes})


async def scan_cube(
    path: Path, tell: Callable[[int], object] = lambda _: None, *, lines: int, resume: bool = False
) -> scanhsi.ScanReport:
    """Scan, or go on with a scan; ``tell`` is called with the last line of each range that was said to be safe."""

    class Telling(CubeWriter):
        async def append(self, line: int) -> range:
            return _told(await super().append(line), tell)

        async def flush(self) -> range:
            return _told(await super().flush(), tell)

    writer, imager.CubeWriter = imager.CubeWriter, Telling  # of this process, which does nothing else
    try:
        async with scanhsi.open_instrument(small()) as hsi:
            if resume:
                return await hsi.resume(path)
            return await hsi.scan(hsi.default_plan(lines=lines, exposure="10 ms", pixel_format="Mono8"), path)
    finally:
        imager.CubeWriter = writer


def _told(safe: range, tell: Callable[[int], object]) -> range:
    if safe:
        tell(safe[-1])
    return safe


def check_lines(path: Path) -> int:
    """What the cube says is stored is what the mirror showed there, and intact; returns how many lines are."""
    assert verify_cube(path, threads=1).intact
    records = read_records(path)
    assert np.all(records.status == 1)
    pixels = scanhsi.open_cube(path)["cube"].values
    for line in range(records.lines):
        seen = decode(pixels[:, line], offset=OFFSET, bits=8)
        assert not seen.moved
        assert seen.step == int(records.mirror_step[line]) % 256, line
    return records.lines


def check_finished(path: Path, lines: int) -> None:
    """All lines are there, each at its place, and no trace of what happened."""
    assert check_lines(path) == lines
    assert cube_summary(path).complete
    assert len(set(np.diff(read_records(path).mirror_step).tolist())) == 1
    assert not verify_cube(path, threads=1).leftovers

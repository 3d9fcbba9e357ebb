"""CPU time of the scan engine per line, with devices that take no time: ``python tests/benchmarks/engine_overhead.py``.

Each device operation resolves through the event loop once ("hop"), as real drivers do. CPU, not wall time: this can be run on a
busy computer. Prints minimum and median of the repeats.
"""

from __future__ import annotations

import asyncio
import statistics
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from scanhsi.clock import run
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import CameraSettings, Exposure, Motion, PixelFormat
from scanhsi.engine import Course, Mode, run_scan
from support.bench import Bench, BenchActuator, BenchCamera

LINES, REPEATS = 6000, 7


class HoppingCamera(BenchCamera):
    """Each exposure goes through the loop once."""

    async def expose(self) -> Exposure:
        await asyncio.sleep(0)
        return await super().expose()


class HoppingActuator(BenchActuator):
    """Each move goes through the loop once."""

    async def move_to(self, step: int) -> Motion:
        await asyncio.sleep(0)
        return await super().move_to(step)


def cpu_us_per_line(mode: Mode) -> float:
    """One scan."""
    bench = Bench(exposure_ms=0, transfer_ms=0, readout_ms=0, move_ms=0)
    steps = np.arange(LINES, dtype=np.int64) % 4000
    course = Course(mode, CameraSettings(0.0, 0.0, PixelFormat.MONO12), steps, steps * 0.1)

    async def main() -> float:
        camera, actuator = HoppingCamera(bench), HoppingActuator(bench)
        begun = time.process_time()
        await run_scan(course, camera, actuator, DiscardSink())
        return (time.process_time() - begun) / LINES * 1e6

    return run(main())


for mode in (Mode.SEQUENTIAL, Mode.STEPPED):
    costs = [cpu_us_per_line(mode) for _ in range(REPEATS)]
    print(
        f"{mode:11s} {min(costs):6.1f} us/line min, {statistics.median(costs):6.1f} median of {REPEATS} x {LINES} lines"
    )

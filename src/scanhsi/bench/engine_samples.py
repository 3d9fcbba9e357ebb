"""What `scanhsi.bench.engine` measures, each once, on whichever loop runs it."""

from __future__ import annotations

import asyncio
import threading
import time

import numpy as np

from scanhsi.bench.idle_devices import IdleActuator, IdleCamera
from scanhsi.bench.lines import Watched
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import CameraSettings, PixelFormat
from scanhsi.engine import Course, Mode, run_scan
from scanhsi.imager import open_instrument
from scanhsi.instrument import InstrumentConfig
from scanhsi.instrument.timing import timing_of
from scanhsi.timing.bounds import Bound, bound
from scanhsi.timing.observed import delivered, exposure_starts


async def cpu_us_per_line(mode: Mode, lines: int) -> float:
    """CPU time of a line with devices that take no time."""
    steps = np.arange(lines, dtype=np.int64)
    course = Course(mode, CameraSettings(0.0, 0.0, PixelFormat.MONO8), steps, np.zeros(lines))
    camera, actuator = IdleCamera(), IdleActuator()
    began_ns = time.process_time_ns()
    await run_scan(course, camera, actuator, DiscardSink())
    return (time.process_time_ns() - began_ns) / lines * 1e-3


async def wake_ups_ns(count: int) -> list[int]:
    """A thread wakes the idle loop, as a camera's does, 1 ms apart."""
    loop, done = asyncio.get_running_loop(), asyncio.Event()
    latencies: list[int] = []

    def woken(sent_ns: int) -> None:
        latencies.append(time.monotonic_ns() - sent_ns)
        if len(latencies) == count:
            done.set()

    def wake() -> None:
        for _ in range(count):
            time.sleep(0.001)
            loop.call_soon_threadsafe(woken, time.monotonic_ns())

    thread = threading.Thread(target=wake, name="wakes the loop")
    thread.start()
    await done.wait()
    thread.join()
    return latencies


async def lateness_ns(count: int, period_s: float) -> list[int]:
    """Timers on an absolute grid; the loop's clock is the monotonic one."""
    loop = asyncio.get_running_loop()
    begin, late = loop.time(), list[int]()
    for number in range(1, count + 1):
        when, fired = begin + number * period_s, loop.create_future()
        loop.call_at(when, fired.set_result, None)
        await fired
        late.append(round((loop.time() - when) * 1e9))
    return late


async def stepped_regret(config: InstrumentConfig, lines: int, exposure_s: float, seed: int) -> Bound:
    """A stepped scan with simulated devices against the bound of the delays they drew.

    Drawn, not as stamped: a simulated device whose timer fires late is late, and that is the loop's doing, too.
    """
    seeded = config.with_seed(seed)
    sink = Watched()
    async with open_instrument(seeded) as imager:
        plan = imager.default_plan(
            lines=lines, exposure_s=exposure_s, pixel_format=PixelFormat.MONO8, mode=Mode.STEPPED, step=1, start=None
        )
        await run_scan(imager.course(plan), imager.camera, imager.actuator, sink)
    drawn = timing_of(seeded).delays(lines, exposure_s, PixelFormat.MONO8, 1)
    stamps = sink.records.stamps
    reached = bound(exposure_starts(stamps), delivered(stamps), drawn, Mode.STEPPED)
    assert reached is not None, "the exposure takes time"
    return reached

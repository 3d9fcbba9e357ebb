"""What the engine and its event loop cost: CPU time a line, wake-up latency, jitter of timers.

Devices take no time, so all that is measured is ours, the loop's and the operating system's. CPU time can be compared between
runs; latency and jitter say as much about what else the computer does, so they are told as percentiles.
"""

from __future__ import annotations

import asyncio
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanhsi.bench.idle_devices import IdleActuator, IdleCamera
from scanhsi.clock import RealTimeLoop
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import CameraSettings, PixelFormat
from scanhsi.engine import Course, Mode, run_scan

LOOPS: Final[dict[str, Callable[[], asyncio.AbstractEventLoop]]] = {
    "scanhsi": RealTimeLoop,
    "asyncio": asyncio.new_event_loop,
}
"""Name -> loop: ours, and the one that asyncio chooses."""

_T = TypeVar("_T")
_SETTLING_S: Final = 0.3
_HOG: Final = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much to measure.

    Attributes:
        lines: Of each scan.
        repeats: Scans of each mode.
        wake_ups: Of a thread that wakes the loop, 1 ms apart.
        timers: On a grid of ``period_s``.
        period_s: Of the timers: one step of the paper's mirror.
    """

    lines: int = 3000
    repeats: int = 5
    wake_ups: int = 500
    timers: int = 300
    period_s: float = 0.0107


@dataclass(frozen=True, slots=True)
class Percentiles:
    """A latency in us."""

    p50_us: float
    p95_us: float
    p99_us: float
    max_us: float


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time of a line in us: least and median of the repeats."""

    min_us: float
    median_us: float


@dataclass(frozen=True, slots=True)
class LoopReport:
    """One event loop under one load.

    Attributes:
        loop: Key of `LOOPS`.
        hogs: Busy processes beside it.
        cpu: Mode -> CPU time of a line.
        wake_up: From a thread's ``call_soon_threadsafe`` to the callback.
        jitter: How late timers on an absolute grid fire.
        early: Timers that fired before their time. Must be 0: the end of an exposure may be timed so.
    """

    loop: str
    hogs: int
    cpu: dict[str, Cost]
    wake_up: Percentiles
    jitter: Percentiles
    early: int


def measure_engine(effort: Effort, *, hogs: int = 0) -> list[LoopReport]:
    """Measure all loops, one after the other.

    Args:
        effort: How much.
        hogs: So many processes keep a processor busy meanwhile.
    """
    with _busy(hogs):
        return [_measure(name, effort, hogs) for name in LOOPS]


def _measure(name: str, effort: Effort, hogs: int) -> LoopReport:
    costs = {
        str(mode): [_run(name, _cpu_us_per_line(mode, effort.lines)) for _ in range(effort.repeats)]
        for mode in (Mode.SEQUENTIAL, Mode.STEPPED)
    }
    late_ns = np.array(_run(name, _lateness_ns(effort)), np.int64)
    return LoopReport(
        loop=name,
        hogs=hogs,
        cpu={mode: Cost(min(cost), statistics.median(cost)) for mode, cost in costs.items()},
        wake_up=_percentiles(np.array(_run(name, _wake_ups_ns(effort)), np.int64)),
        jitter=_percentiles(late_ns),
        early=int((late_ns < 0).sum()),
    )


def _run(name: str, main: Coroutine[Any, Any, _T]) -> _T:
    with asyncio.Runner(loop_factory=LOOPS[name]) as runner:
        return runner.run(main)


async def _cpu_us_per_line(mode: Mode, lines: int) -> float:
    steps = np.arange(lines, dtype=np.int64)
    course = Course(mode, CameraSettings(0.0, 0.0, PixelFormat.MONO8), steps, np.zeros(lines))
    camera, actuator = IdleCamera(), IdleActuator()
    began_ns = time.process_time_ns()
    await run_scan(course, camera, actuator, DiscardSink())
    return (time.process_time_ns() - began_ns) / lines * 1e-3


async def _wake_ups_ns(effort: Effort) -> list[int]:
    """A thread wakes the idle loop, as a camera's does."""
    loop, done = asyncio.get_running_loop(), asyncio.Event()
    latencies: list[int] = []

    def woken(sent_ns: int) -> None:
        latencies.append(time.monotonic_ns() - sent_ns)
        if len(latencies) == effort.wake_ups:
            done.set()

    def wake() -> None:
        for _ in range(effort.wake_ups):
            time.sleep(0.001)
            loop.call_soon_threadsafe(woken, time.monotonic_ns())

    thread = threading.Thread(target=wake, name="wakes the loop")
    thread.start()
    await done.wait()
    thread.join()
    return latencies


async def _lateness_ns(effort: Effort) -> list[int]:
    """Timers on an absolute grid; the loop's clock is the monotonic one."""
    loop = asyncio.get_running_loop()
    begin, late = loop.time(), list[int]()
    for number in range(1, effort.timers + 1):
        when, fired = begin + number * effort.period_s, loop.create_future()
        loop.call_at(when, fired.set_result, None)
        await fired
        late.append(round((loop.time() - when) * 1e9))
    return late


def _percentiles(latencies_ns: NDArray[np.int64]) -> Percentiles:
    p50, p95, p99 = (np.percentile(latencies_ns, [50, 95, 99]) * 1e-3).tolist()
    return Percentiles(p50, p95, p99, float(latencies_ns.max()) * 1e-3)


@contextmanager
def _busy(hogs: int) -> Generator[None]:
    """Processes that keep a processor busy; each ends by itself should this one vanish."""
    running = [subprocess.Popen([sys.executable, "-c", _HOG]) for _ in range(hogs)]
    try:
        if running:
            time.sleep(_SETTLING_S)
        yield
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait()

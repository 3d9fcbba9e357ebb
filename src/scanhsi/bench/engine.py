"""What the engine and its event loop cost: CPU time a line, wake-up latency, jitter of timers, and regret in real time.

The first three are measured with devices that take no time, so all of it is ours, the loop's and the operating system's. Regret is
that of stepped scans with simulated devices, against the bound of the delays these drew. CPU time can be compared between runs;
the rest says as much about what else the computer does. So loops, loads and options take turns, and spreads are told.
"""

from __future__ import annotations

import asyncio
import statistics
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np

from scanhsi.bench.engine_samples import cpu_us_per_line, lateness_ns, stepped_regret, wake_ups_ns
from scanhsi.bench.hogs import busy
from scanhsi.clock import Granted, RealTime, RealTimeLoop, real_time
from scanhsi.engine import Mode
from scanhsi.instrument import load_instrument
from scanhsi.timing.bounds import Bound

LOOPS: Final[dict[str, Callable[[], asyncio.AbstractEventLoop]]] = {
    "precise": RealTimeLoop,
    "asyncio": asyncio.new_event_loop,
}
"""Name -> loop: ours, and the one that asyncio chooses."""
INSTRUMENT: Final = "sensors2019"
"""Whose simulated devices are scanned with: those of the paper."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Effort:
    """How much to measure.

    Attributes:
        lines: Of each scan with devices that take no time.
        rounds: In each, every loop takes its turn under every load with every choice of options.
        wake_ups: Each round, of a thread that wakes the loop, 1 ms apart.
        timers: Each round, on a grid of ``period_s``.
        period_s: Of the timers: one step of the paper's mirror.
        scan_lines: Each round, of a stepped scan with simulated devices.
        exposure_s: Of its lines.
    """

    lines: int = 3000
    rounds: int = 5
    wake_ups: int = 100
    timers: int = 60
    period_s: float = 0.0107
    scan_lines: int = 60
    exposure_s: float = 0.020


@dataclass(frozen=True, slots=True)
class Percentiles:
    """A latency in us."""

    p50_us: float
    p95_us: float
    p99_us: float
    max_us: float


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time of a line in us: least and median of the rounds."""

    min_us: float
    median_us: float


@dataclass(frozen=True, slots=True)
class Regret:
    """Time of a scan over the least that the drawn delays allow.

    Attributes:
        exposure_s: Of a line.
        lines: Of each scan.
        bound_s: Shortest line period, mean of the rounds.
        runs: Regret of each round; in one round all conditions draw the same delays.
    """

    exposure_s: float
    lines: int
    bound_s: float
    runs: tuple[float, ...]

    @property
    def median(self) -> float:
        """Of the rounds."""
        return statistics.median(self.runs)

    @property
    def excess_s(self) -> float:
        """What the median costs a line."""
        return (self.median - 1) * self.bound_s


@dataclass(frozen=True, slots=True)
class LoopReport:
    """One event loop under one load, with or without real-time options.

    Attributes:
        loop: Key of `LOOPS`.
        hogs: Busy processes beside it.
        real_time: Options asked for, granted and refused.
        cpu: Mode -> CPU time of a line.
        wake_up: From a thread's ``call_soon_threadsafe`` to the callback.
        jitter: How late timers on an absolute grid fire.
        early: Timers that fired before their time. Must be 0: the end of an exposure may be timed so.
        regret: Of stepped scans.
    """

    loop: str
    hogs: int
    real_time: Granted
    cpu: dict[str, Cost]
    wake_up: Percentiles
    jitter: Percentiles
    early: int
    regret: Regret


@dataclass(slots=True)
class _Case:
    """A loop, a load and options, and what was measured so far."""

    loop: str
    hogs: int
    options: RealTime
    granted: list[Granted] = field(default_factory=list[Granted])
    cpu_us: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    wake_ns: list[int] = field(default_factory=list[int])
    late_ns: list[int] = field(default_factory=list[int])
    reached: list[Bound] = field(default_factory=list[Bound])


def measure_engine(
    effort: Effort, *, hogs: int = 0, options: RealTime | None = None, tell: Callable[[str], None] | None = None
) -> list[LoopReport]:
    """Measure all loops.

    Args:
        effort: How much.
        hogs: Measure not only undisturbed but also while so many processes keep a processor busy each.
        options: Measure not only without but also with these.
        tell: Called with what is being done, once a round and load.
    """
    choices = [RealTime(), *([options] if options is not None and options.asked else [])]
    loads = [0, *([hogs] if hogs else [])]
    cases = [_Case(loop, load, choice) for load in loads for loop in LOOPS for choice in choices]
    config = load_instrument(INSTRUMENT, {"camera.scene": "dark", "actuator.home_s": 0.0})
    for number in range(effort.rounds):
        for load in loads:
            if tell is not None:
                tell(f"round {number + 1}/{effort.rounds}, {load} busy processes")
            with busy(load):
                for case in cases:
                    if case.hogs == load:
                        _run(case, _measure(case, effort))
                        scan = stepped_regret(config, effort.scan_lines, effort.exposure_s, number)
                        case.reached.append(_run(case, scan))
    return [_report(case, effort) for case in cases]


async def _measure(case: _Case, effort: Effort) -> None:
    for mode in (Mode.SEQUENTIAL, Mode.STEPPED):
        case.cpu_us.setdefault(str(mode), []).append(await cpu_us_per_line(mode, effort.lines))
    case.wake_ns += await wake_ups_ns(effort.wake_ups)
    case.late_ns += await lateness_ns(effort.timers, effort.period_s)


def _run(case: _Case, main: Coroutine[Any, Any, _T]) -> _T:
    async def under_options() -> _T:
        with real_time(case.options) as granted:
            case.granted.append(granted)
            return await main

    with asyncio.Runner(loop_factory=LOOPS[case.loop]) as runner:
        return runner.run(under_options())


def _report(case: _Case, effort: Effort) -> LoopReport:
    return LoopReport(
        loop=case.loop,
        hogs=case.hogs,
        real_time=case.granted[0],
        cpu={mode: Cost(min(cost), statistics.median(cost)) for mode, cost in case.cpu_us.items()},
        wake_up=_percentiles(case.wake_ns),
        jitter=_percentiles(case.late_ns),
        early=sum(late < 0 for late in case.late_ns),
        regret=Regret(
            exposure_s=effort.exposure_s,
            lines=effort.scan_lines,
            bound_s=statistics.mean(reached.period_s for reached in case.reached),
            runs=tuple(reached.regret for reached in case.reached),
        ),
    )


def _percentiles(latencies_ns: list[int]) -> Percentiles:
    p50, p95, p99 = (np.percentile(latencies_ns, [50, 95, 99]) * 1e-3).tolist()
    return Percentiles(p50, p95, p99, max(latencies_ns) * 1e-3)

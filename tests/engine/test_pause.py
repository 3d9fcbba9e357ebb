"""Pauses: at any moment, for any time, and nothing of it is seen in the lines."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from scanhsi.clock import run_virtual
from scanhsi.devices import CameraSettings, PixelFormat
from scanhsi.engine import Course, Mode, Progress, ScanControl, ScanReport, run_scan
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 12


def course(mode: Mode, stride: int = 1) -> Course:
    steps = 10 + stride * np.arange(LINES, dtype=np.int64)
    return Course(mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 0.1)


class Paused:
    """A scan that is paused at a time, for a while; what was true in the middle of the pause."""

    def __init__(self, mode: Mode, at_s: float, for_s: float = 10.0, *, homed: bool = True) -> None:
        self.mode, self.at_s, self.for_s = mode, at_s, for_s
        self.bench = Bench(homed=homed)
        self.sink = MemorySink(batch=50, capacity=60)  # lines would be stored much later, but for the pause
        self.control = ScanControl()
        self.seen: dict[str, object] = {}
        self.states: list[str] = []

    def _look(self) -> None:
        bench, records = self.bench, self.sink.records
        standing, exposures, motions = self.control.standing.is_set(), len(bench.exposures), len(bench.motions)
        self.seen = {"still": bench.stopped, "armed": bench.armed, "standing": standing, "stored": records.stored}
        self.seen |= {"exposures": exposures, "motions": motions, "lines": len(self.sink.pixels)}

    def _told(self, progress: Progress) -> None:
        self.states.append(progress.state)

    async def main(self) -> ScanReport:
        loop = asyncio.get_running_loop()
        loop.call_later(self.at_s, self.control.pause)
        loop.call_later(self.at_s + self.for_s / 2, self._look)
        loop.call_later(self.at_s + self.for_s, self.control.go_on)
        camera, actuator = BenchCamera(self.bench), BenchActuator(self.bench)
        return await run_scan(
            course(self.mode), camera, actuator, self.sink, control=self.control, on_progress=self._told
        )


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("at_s", [0.0, 0.0021, 0.006, 0.012, 0.0159, 0.02, 0.04, 0.13, 0.2])
def test_a_pause_at_any_moment(mode: Mode, at_s: float) -> None:
    scan = Paused(mode, at_s)
    report = run_virtual(scan.main())
    assert (report.stored, report.missing, report.stopped_early) == (LINES, 0, False)
    for line in range(LINES):
        assert np.all(scan.sink.pixels[line] == 10 + line), line
    assert scan.seen["still"]
    assert (scan.seen["armed"], scan.seen["standing"]) == (False, True)
    assert scan.seen["stored"] == scan.seen["lines"], "what was taken is stored"
    (incident,) = report.incidents
    assert (incident.kind, incident.cause) == ("pause", "asked for")
    assert 9.8 < incident.lasted_s < 10.2
    assert report.period_s < 1
    assert "paused" in scan.states
    assert scan.states[-1] == "scanning"


@pytest.mark.parametrize("mode", Mode)
def test_a_pause_while_homing(mode: Mode) -> None:
    scan = Paused(mode, 0.3, homed=False)
    report = run_virtual(scan.main())
    assert report.stored == LINES
    assert scan.seen["exposures"] == 0


@pytest.mark.parametrize("mode", Mode)
def test_a_pause_that_is_over_before_the_line_is(mode: Mode) -> None:
    scan = Paused(mode, 0.1, for_s=0.001)
    report = run_virtual(scan.main())
    assert report.stored == LINES
    assert report.duration_s < 2


def test_stopped_in_a_pause() -> None:
    scan = Paused(Mode.STEPPED, 0.1, for_s=1e6)

    async def main() -> ScanReport:
        asyncio.get_running_loop().call_later(3.0, scan.control.stop.set)
        return await scan.main()

    report = run_virtual(main())
    assert report.stopped_early
    assert 0 < report.stored < LINES
    assert report.incidents[0].action == "the scan ended"
    assert scan.bench.stopped


def test_several_pauses() -> None:
    scan = Paused(Mode.STEPPED, 0.05, for_s=1.0)

    async def main() -> ScanReport:
        loop = asyncio.get_running_loop()
        loop.call_later(1.1, scan.control.pause)
        loop.call_later(1.3, scan.control.go_on)
        return await scan.main()

    report = run_virtual(main())
    assert report.stored == LINES
    assert len(report.incidents) == 2

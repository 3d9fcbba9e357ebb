"""``scanhsi bench engine``: it measures what it says; how fast this computer is, is not tested."""

import os
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from scanhsi.bench import hogs
from scanhsi.bench.engine import LOOPS, Effort, LoopReport, measure_engine
from scanhsi.bench.idle_devices import IdleActuator, IdleCamera
from scanhsi.clock import RealTime, run
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import Actuator, Camera, CameraSettings, PixelFormat
from scanhsi.engine import Course, Mode, run_scan

LITTLE = Effort(lines=20, rounds=2, wake_ups=5, timers=4, period_s=0.002, scan_lines=4)


@pytest.fixture(scope="module")
def reports() -> list[LoopReport]:
    return measure_engine(LITTLE)


def test_every_loop_is_measured(reports: list[LoopReport]) -> None:
    assert [report.loop for report in reports] == list(LOOPS)
    assert not any(report.hogs or report.real_time.asked for report in reports)
    assert next(iter(reports)).real_time.loop == "precise"


def test_numbers_are_in_order(reports: list[LoopReport]) -> None:
    for report in reports:
        assert set(report.cpu) == {"sequential", "stepped"}
        for cost in report.cpu.values():
            assert 0 < cost.min_us <= cost.median_us
        for times in (report.wake_up, report.jitter):
            assert times.p50_us <= times.p95_us <= times.p99_us <= times.max_us
        assert report.wake_up.p50_us > 0


def test_no_loop_beats_the_bound(reports: list[LoopReport]) -> None:
    for report in reports:
        assert len(report.regret.runs) == LITTLE.rounds
        assert min(report.regret.runs) >= 1
        assert report.regret.bound_s > LITTLE.exposure_s
    assert len({report.regret.bound_s for report in reports}) == 1, "all draw the same delays"


def test_options_are_measured_beside_none_of_them() -> None:
    reports = measure_engine(replace(LITTLE, rounds=1), options=RealTime.of("gc,switch"))
    assert [(report.loop, report.real_time.asked) for report in reports] == [
        (loop, asked) for loop in LOOPS for asked in ((), ("gc", "switch"))
    ]


@pytest.mark.parametrize("mode", [Mode.SEQUENTIAL, Mode.STEPPED])
def test_idle_devices_lose_no_line(mode: Mode) -> None:
    camera, actuator = IdleCamera(), IdleActuator()
    assert isinstance(camera, Camera)
    assert isinstance(actuator, Actuator)
    course = Course(mode, CameraSettings(0.0, 0.0, PixelFormat.MONO8), np.arange(9), np.zeros(9))
    report = run(run_scan(course, camera, actuator, DiscardSink()))
    assert not report.missing
    assert not report.stopped_early
    assert actuator.position == 8


def test_busy_processes_end_with_the_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Seen(subprocess.Popen[bytes]):
        def __init__(self, *words, **options) -> None:
            super().__init__(*words, **options)
            started.append(self)

    monkeypatch.setattr(hogs.subprocess, "Popen", Seen)
    reports = measure_engine(replace(LITTLE, rounds=1), hogs=1)
    assert [report.hogs for report in reports] == [0, 0, 1, 1]
    assert len(started) == 1
    assert started[0].returncode is not None
    with pytest.raises(ProcessLookupError):
        os.kill(started[0].pid, 0)

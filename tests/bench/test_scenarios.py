"""Scenarios: the engine runs as ever; the mirror stands, the pixels are not touched."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from scanhsi.bench.scenarios import Scenario, Standing, Unread, staged
from scanhsi.clock import run_virtual
from scanhsi.devices import Actuator, Camera, CameraSettings, PixelFormat
from scanhsi.devices.errors import OutOfRange
from scanhsi.engine import Course, Mode, ScanReport, run_scan
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 12


@dataclass(frozen=True)
class Devices:
    camera: Camera
    actuator: Actuator


@dataclass(frozen=True)
class Stage:
    instrument: Devices
    run: str = "x"


def scan(scenario: Scenario, mode: Mode = Mode.SEQUENTIAL) -> tuple[ScanReport, Bench, MemorySink]:
    bench, sink = Bench(exposure_ms=20, transfer_ms=5, copy_ms=2, move_ms=3), MemorySink()
    steps = np.arange(LINES, dtype=np.int64)
    course = Course(mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 0.1)

    async def main() -> ScanReport:
        imager: Any = Stage(Devices(BenchCamera(bench), BenchActuator(bench)))
        instrument = staged(imager, scenario).instrument
        return await run_scan(course, instrument.camera, instrument.actuator, sink)

    return run_virtual(main()), bench, sink


def test_full_does_everything() -> None:
    report, bench, _ = scan(Scenario.FULL)
    assert len(bench.motions) == LINES
    assert report.period_s == pytest.approx(0.030)


def test_static_exposes_and_stores_and_does_not_move() -> None:
    report, bench, sink = scan(Scenario.STATIC)
    assert bench.motions == []
    assert bench.position == 7
    assert len(bench.exposures) == report.stored == len(sink.pixels) == LINES
    assert report.period_s == pytest.approx(0.027)
    assert bench.stopped
    assert not bench.armed


def test_acquire_receives_every_frame_and_touches_none() -> None:
    report, bench, sink = scan(Scenario.ACQUIRE)
    assert bench.motions == []
    assert len(bench.exposures) == LINES
    assert not any(pixels.any() for pixels in sink.pixels.values())
    assert report.period_s == pytest.approx(0.025)


def test_stepped_scenarios_overlap() -> None:
    assert scan(Scenario.STATIC, Mode.STEPPED)[0].period_s == pytest.approx(0.020)


def test_a_standing_mirror_keeps_its_limits_and_its_place() -> None:
    bench = Bench()
    standing = Standing(BenchActuator(bench))

    async def main() -> None:
        assert standing.position == 7
        with pytest.raises(OutOfRange):
            await standing.move_to(999_999)
        motion = await standing.move_to(40)
        assert (motion.step, motion.moved_ns - motion.commanded_ns) == (40, 0)
        assert standing.position == 40
        await standing.home()

    run_virtual(main())
    assert bench.motions == []
    assert isinstance(standing, Actuator)
    assert isinstance(Unread(BenchCamera(bench)), Camera)

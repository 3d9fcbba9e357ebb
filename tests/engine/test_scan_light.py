"""The light of a scan: on and steady before the first line, off on every way out, whatever else goes wrong there."""

import asyncio
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices import CameraSettings, LightInfo, Lit, PixelFormat, Range
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceUnsafe, ScanFailed
from scanhsi.engine import Course, Mode, Progress, ScanControl, ScanReport, run_scan
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 12


class BenchLight:
    """Writes down when it was switched. Faults: `broken` does not go on, `stuck` hangs when it shall go off."""

    def __init__(self, bench: Bench, *, warm_up_s: float = 0.0, broken: bool = False, stuck: bool = False) -> None:
        self.bench = bench
        self.info = LightInfo("light bench", "bench", "1", Range(1, 1), warm_up_s, simulated=True)
        self.level = 0.0
        self.broken, self.stuck = broken, stuck
        self.spans: list[list[int]] = []

    async def connect(self) -> None: ...

    async def close(self) -> None:
        await self.off()

    async def on(self, level: float | None = None) -> Lit:
        commanded = now_ns()
        await asyncio.sleep(0.01)
        if self.broken:
            raise DeviceLost("the bulb is gone.", device=self.info.name)
        self.level = 1.0
        self.spans.append([now_ns()])
        return Lit(1.0, commanded, now_ns(), now_ns() + round(self.info.warm_up_s * 1e9))

    async def off(self) -> None:
        if self.stuck:
            await asyncio.Event().wait()
        await asyncio.sleep(0.01)
        if self.level:
            self.spans[-1].append(now_ns())
        self.level = 0.0


def course(mode: Mode = Mode.STEPPED) -> Course:
    steps = np.arange(LINES, dtype=np.int64)
    return Course(mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 1e-4)


def scan(
    light: BenchLight, camera: object = None, actuator: object = None, mode: Mode = Mode.STEPPED, **kwargs: object
) -> ScanReport:
    bench = light.bench

    async def main() -> ScanReport:
        return await run_scan(
            course(mode),
            camera or BenchCamera(bench),
            actuator or BenchActuator(bench),
            MemorySink(),
            light=light,
            **kwargs,
        )

    return run_virtual(main())


@pytest.mark.parametrize("mode", list(Mode))
def test_it_is_on_during_every_exposure_and_off_in_the_end(mode: Mode) -> None:
    bench = Bench()
    light = BenchLight(bench, warm_up_s=30.0)
    assert scan(light, mode=mode).stored == LINES
    assert light.level == 0
    ((on, off),) = light.spans
    assert bench.exposures
    assert all(on + 30e9 - 1e6 <= start and end <= off for start, end in bench.exposures)


def test_warming_up_is_told_and_ends_when_somebody_wants_to_stop() -> None:
    bench, light, states = Bench(), BenchLight(Bench(), warm_up_s=600.0), list[str]()
    control = ScanControl()

    def progress(told: Progress) -> None:
        states.append(told.state)
        if told.state == "warming up":
            control.stop.set()

    report = scan(light, BenchCamera(bench), BenchActuator(bench), control=control, on_progress=progress)
    assert report.stored == 0
    assert "warming up" in states
    assert light.level == 0
    assert light.spans[0][1] - light.spans[0][0] < 600e9


def test_a_light_that_does_not_go_on_ends_the_scan_before_a_line_is_taken() -> None:
    bench = Bench()
    with pytest.raises(ScanFailed, match="the bulb is gone"):
        scan(BenchLight(bench, broken=True))
    assert bench.exposures == []
    assert bench.moves == 0


@pytest.mark.parametrize("fail_at", range(0, 40, 3))
def test_it_goes_off_whatever_fails(fail_at: int) -> None:
    bench = Bench(fail_at=fail_at)
    light = BenchLight(bench)
    with pytest.raises(DeviceError if fail_at == 0 else ScanFailed):
        scan(light)
    assert light.level == 0


@pytest.mark.parametrize("after_ms", [1, 15, 40, 130, 250, 300])
def test_it_goes_off_when_the_scan_is_cancelled(after_ms: int) -> None:
    bench = Bench()
    light = BenchLight(bench)

    async def main() -> None:
        task = asyncio.ensure_future(
            run_scan(course(), BenchCamera(bench), BenchActuator(bench), MemorySink(), light=light)
        )
        await asyncio.sleep(after_ms * 1e-3)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run_virtual(main())
    assert light.level == 0


async def hangs() -> None:
    await asyncio.Event().wait()


async def fails() -> None:
    raise DeviceLost("it is gone.", device="bench")


@pytest.mark.parametrize("way", [hangs, fails])
@pytest.mark.parametrize("who", ["actuator", "camera", "both"])
def test_it_goes_off_also_where_the_cleanup_of_another_device_hangs_or_fails(
    way: Callable[..., object], who: str
) -> None:
    bench = Bench()
    light, camera, actuator = BenchLight(bench), BenchCamera(bench), BenchActuator(bench)
    if who != "camera":
        actuator.stop = way  # pyright: ignore[reportAttributeAccessIssue]
    if who != "actuator":
        camera.disarm = way  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ScanFailed):
        scan(light, camera, actuator)
    assert light.level == 0


def test_a_light_that_cannot_be_switched_off_is_unsafe_and_the_rest_is_safe() -> None:
    bench = Bench()
    light = BenchLight(bench, stuck=True)
    with pytest.raises(ScanFailed, match="the light may be on") as caught:
        scan(light)
    assert [(type(error), error.device) for error in caught.value.unsafe] == [(DeviceUnsafe, "light bench")]
    assert caught.value.stored == LINES
    assert bench.stopped
    assert not bench.armed


def test_a_scan_that_is_refused_switches_nothing() -> None:
    bench = Bench()
    light = BenchLight(bench)

    async def main() -> None:
        wrong = replace(course(), settings=CameraSettings(99.0))
        await run_scan(wrong, BenchCamera(bench), BenchActuator(bench), MemorySink(), light=light)

    with pytest.raises(DeviceError):
        run_virtual(main())
    assert light.spans == []

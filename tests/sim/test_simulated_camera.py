"""The simulated camera against its contract and its schedule, in virtual time, to the ns."""

import asyncio
import gc
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanhsi.clock import now_ns, run, run_virtual, sleep_until_ns
from scanhsi.devices import (
    CameraSettings,
    Exposure,
    Frame,
    FrameGap,
    FreeRunning,
    HardwareTriggered,
    OverlapsReadout,
    PixelFormat,
    Roi,
    Role,
    Trigger,
    find,
)
from scanhsi.devices.errors import DeviceBusy, DeviceError, OutOfRange
from scanhsi_sim import CameraOptions, camera_backend
from scanhsi_sim.bench import bench
from scanhsi_sim.camera import OverlappingCamera, SimulatedCamera
from scanhsi_sim.scenes.testpattern import Decoded, decode

MS = 1_000_000
DELAYS = {"T_rd": 20, "T_rx": 18, "T_api": 2, "T_mcpy": 3, "T_dead": 1, "T_trig": 0.25, "T_ev": 0.5, "t1": 0.125}
SMALL = {"bands": 12, "samples": 16, "scene": "testpattern"}


@pytest.fixture
def profile(tmp_path: Path) -> Callable[..., str]:
    """Writes a profile of constant delays in ms."""

    def write(**delays_ms: float) -> str:
        streams = {
            name: {"note": "", "mark": "invented", "delay": {"kind": "constant", "unit": "ms", "value": value}}
            for name, value in delays_ms.items()
        }
        path = tmp_path / f"{abs(hash(tuple(delays_ms.items())))}.json"
        path.write_text(json.dumps({"schema": 1, "name": "t", "source": "", "mark": "invented", "streams": streams}))
        return str(path)

    return write


def camera(profile: str, **options: Any) -> SimulatedCamera:
    made = camera_backend.create(CameraOptions(profile=profile, **{**SMALL, **options}))
    assert isinstance(made, SimulatedCamera)
    return made


async def armed(
    device: SimulatedCamera,
    exposure_s: float = 0.1,
    trigger: Trigger = Trigger.SOFTWARE,
    buffers: int = 16,
    pixel_format: PixelFormat = PixelFormat.MONO8,
    roi: Roi | None = None,
) -> SimulatedCamera:
    await device.connect()
    await device.configure(CameraSettings(exposure_s, 0.0, pixel_format, roi))
    await device.arm(trigger, buffers)
    return device


def virtually(main: Callable[[], Awaitable[Any]]) -> Any:
    async def wrapped() -> Any:
        return await main()

    return run_virtual(wrapped())


async def take(device: SimulatedCamera, count: int) -> list[Any]:
    stream = device.frames()
    return [await anext(stream) for _ in range(count)]


async def burst(device: SimulatedCamera, count: int) -> tuple[list[Exposure], list[Any]]:
    exposures = [await device.expose() for _ in range(count)]
    return exposures, await take(device, count)


def schedule(count: int, *, overlap: bool, exposure: int, rx: int, d: dict[str, int]) -> list[tuple[int, int, int]]:
    """(S, E, X) of back-to-back exposures by the recursion of the model, independent of the code."""
    result: list[tuple[int, int, int]] = []
    host = read = end = received = 0
    for line in range(count):
        start = host + d["T_trig"]
        if line:
            start = max(start, max(end + d["T_dead"], read - exposure) if overlap else read)
        end = start + exposure
        read = end + d["T_rd"]
        received = max(max(end + d["t1"], received) + rx + d["T_api"], read)
        host = end + d["T_ev"]
        result.append((start, end, received))
    return result


@pytest.mark.parametrize("overlap", [True, False])
@pytest.mark.parametrize("exposure_ms", [10, 15, 20, 100])
@pytest.mark.parametrize("rx_ms", [5, 18, 36])
def test_the_schedule_is_that_of_the_model(
    profile: Callable[..., str], overlap: bool, exposure_ms: int, rx_ms: int
) -> None:
    delays = {**DELAYS, "T_rx": rx_ms}

    async def main() -> None:
        device = await armed(camera(profile(**delays), overlap=overlap), exposure_ms * 1e-3)
        exposures, frames = await burst(device, 9)
        measured = [(e.start_ns, e.end_ns, f.received_ns) for e, f in zip(exposures, frames, strict=True)]
        ns = {name: round(value * MS) for name, value in delays.items()}
        assert measured == schedule(9, overlap=overlap, exposure=exposure_ms * MS, rx=rx_ms * MS, d=ns)
        await device.close()

    virtually(main)


def test_expose_returns_at_the_end_of_exposure_with_true_stamps(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(**DELAYS)))
        exposure = await device.expose()
        assert exposure == Exposure(0, 0, MS // 4, 100 * MS + MS // 4, timed=False)
        assert now_ns() == exposure.end_ns + MS // 2
        [frame] = await take(device, 1)
        assert frame.received_ns == now_ns() == exposure.end_ns + 20 * MS + MS // 8
        assert (frame.first_byte_ns, frame.exposure_start_ns) == (exposure.end_ns + MS // 8, exposure.start_ns)
        assert (frame.index, frame.frame_id, frame.shape, frame.payload) == (0, 1, (12, 16), None)
        await device.close()

    virtually(main)


def test_unpacking_costs_the_copy_and_renders_only_on_demand(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(**DELAYS)))
        _, frames = await burst(device, 2)
        began = now_ns()
        await device.unpack(frames[0], None)
        assert now_ns() - began == 3 * MS
        assert frames[0].pixels is None
        out = np.zeros((12, 16), np.uint8)
        await device.unpack(frames[1], out)
        assert now_ns() - began == 6 * MS
        assert decode(out, bits=8) == Decoded(0, moved=False)
        await device.close()

    virtually(main)


def test_transfer_and_copy_of_a_region_cost_its_share(profile: Callable[..., str]) -> None:
    async def main() -> None:
        roi = Roi(4, 3, 8, 6)  # a quarter of the bytes
        device = await armed(camera(profile(T_rx=18, T_mcpy=4, T_rd=1)), roi=roi, pixel_format=PixelFormat.MONO12)
        exposures, [frame] = await burst(device, 1)
        assert frame.received_ns - exposures[0].end_ns == 4.5 * MS
        out = np.zeros((6, 8), np.uint16)
        began = now_ns()
        await device.unpack(frame, out)
        assert now_ns() - began == MS
        assert decode(out, offset=(3, 4)) == Decoded(0, moved=False)
        await device.close()

    virtually(main)


def test_a_frame_shows_where_the_mirror_was(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(), bench="moved"))
        mirror = bench("moved").mirror
        mirror.move(0, 50 * MS, 30)
        mirror.move(250 * MS, 260 * MS, 31)
        _, frames = await burst(device, 3)
        assert [frame.steps for frame in frames] == [(0, 30), (30, 30), (30, 31)]
        out = np.zeros((12, 16), np.uint8)
        await device.unpack(frames[2], out)
        assert decode(out, bits=8) == Decoded(30, moved=True)
        await device.close()

    virtually(main)


def test_frames_beyond_the_buffers_are_lost_and_reported(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(T_rx=5)), buffers=2)
        for _ in range(4):
            await device.expose()
        events = await take(device, 4)
        assert [isinstance(event, Frame) for event in events] == [True, True, False, False]
        assert events[2] == FrameGap(2, 1, "no free buffer")
        events.clear()  # the buffers go back
        await device.expose()
        [frame] = await take(device, 1)
        assert frame.index == 4
        await device.close()

    virtually(main)


def test_triggers_that_come_too_soon_are_lost_and_counted(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(T_rd=20, T_dead=1), bench="line"), 0.1, Trigger.LINE)
        line = bench("line")
        for when_ms in (0, 50, 100, 101, 301):
            await sleep_until_ns(when_ms * MS)
            line.pulse(now_ns())
        events = await take(device, 5)
        assert [event.index if isinstance(event, Frame) else event for event in events] == [
            0,
            FrameGap(1, 1, "trigger came while the sensor was busy"),
            FrameGap(2, 1, "trigger came while the sensor was busy"),
            3,
            4,
        ]
        assert [event.exposure_start_ns for event in events if isinstance(event, Frame)] == [0, 101 * MS, 301 * MS]
        await device.disarm()
        line.pulse(now_ns())  # nobody listens any more
        assert line.exposures == 0
        await device.close()

    virtually(main)


@pytest.mark.parametrize(("overlap", "exposure_ms", "shortest_ms"), [(True, 100, 101), (True, 10, 20), (False, 10, 30)])
def test_the_shortest_trigger_period_loses_nothing(
    profile: Callable[..., str], overlap: bool, exposure_ms: int, shortest_ms: float
) -> None:
    async def main() -> None:
        device = await armed(camera(profile(**DELAYS), overlap=overlap, bench="fast"), exposure_ms * 1e-3, Trigger.LINE)
        period_s = device.shortest_trigger_period_s()
        assert period_s == pytest.approx(shortest_ms * 1e-3)
        for pulse in range(12):
            await sleep_until_ns(round(pulse * period_s * 1e9))
            bench("fast").pulse(now_ns())
        assert all(isinstance(event, Frame) for event in await take(device, 12))
        await device.close()

    virtually(main)


def test_free_run_keeps_its_period_exactly(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = camera(profile(**DELAYS))
        await device.connect()
        await device.configure(CameraSettings(0.03, 0, PixelFormat.MONO8))
        with pytest.raises(OutOfRange, match="frame period 0.02 s is not allowed; allowed is 0.031"):
            await device.set_frame_period(0.02)
        assert await device.set_frame_period(0.0333333333) == pytest.approx(0.033333333)
        await device.arm(Trigger.FREE_RUN, 8)
        starts = []
        async for frame in device.frames():
            assert isinstance(frame, Frame)
            starts.append(frame.exposure_start_ns)
            if len(starts) == 50:
                break
        assert starts == [33_333_333 * beat for beat in range(50)]
        await device.close()

    virtually(main)


def test_disarming_reports_what_never_arrived_and_ends_the_frames(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(**{**DELAYS, "T_rx": 150})))
        stream = device.frames()
        for _ in range(3):
            await device.expose()
        await device.disarm()
        events = [event async for event in stream]
        assert [event.index for event in events[:-1]] == [0]
        assert events[-1] == FrameGap(1, 2, "the camera was disarmed before the frame arrived")
        await device.disarm()
        await device.close()
        await device.close()

    virtually(main)


def test_frames_that_nobody_took_die_with_their_acquisition(profile: Callable[..., str]) -> None:
    """Thousands of frames may be left behind by a scan that takes lines anew again and again."""

    async def main() -> None:
        device = await armed(camera(profile(**DELAYS)))
        await device.expose()
        await asyncio.sleep(1)
        gc.collect()
        before = [thing for thing in gc.get_objects() if isinstance(thing, Frame)]
        assert len(before) == 1
        before.clear()
        await device.disarm()
        gc.collect()
        assert not [thing for thing in gc.get_objects() if isinstance(thing, Frame)]
        await device.close()

    virtually(main)


def test_a_cancelled_exposure_goes_on(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(**DELAYS)))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await device.expose()
        exposure = await device.expose()
        assert exposure.index == 1
        assert exposure.start_ns == round(100.25 * MS) + MS
        assert [frame.index for frame in await take(device, 2)] == [0, 1]
        await device.close()

    virtually(main)


def test_a_trigger_that_waits_is_withdrawn_by_disarm(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(T_rd=500)))
        await device.expose()
        waiting = asyncio.create_task(device.expose())
        await asyncio.sleep(0.01)
        await device.disarm()
        with pytest.raises(DeviceError, match="disarmed while the trigger waited"):
            await waiting
        await device.close()

    virtually(main)


def test_a_cancelled_unpack_leaves_the_buffer_alone_afterwards(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(**DELAYS)))
        _, [frame] = await burst(device, 1)
        out = np.zeros((12, 16), np.uint8)
        job = asyncio.create_task(device.unpack(frame, out))
        await asyncio.sleep(0.001)
        job.cancel()
        await asyncio.wait([job])
        assert job.cancelled()
        assert decode(out, bits=8).step == 0  # written to the end before the caller had it back
        await device.close()

    virtually(main)


def test_in_real_time_the_pixels_are_the_same(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = await armed(camera(profile(T_rx=1, T_mcpy=1)), 0.01)
        out = np.zeros((12, 16), np.uint8)
        for _ in range(4):  # from the second on they are rendered ahead
            exposure = await device.expose()
            frame = await anext(device.frames())
            assert isinstance(frame, Frame)
            assert frame.received_ns >= exposure.end_ns + MS
            out[:] = 0
            await device.unpack(frame, out)
            assert decode(out, bits=8) == Decoded(0, moved=False)
        await device.close()

    run(main())


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        (CameraSettings(0.001), "exposure 0.001 s is not allowed; allowed is 0.01 to 2 s"),
        (CameraSettings(0.1, 25.5), "gain 25.5 dB is not allowed; allowed is 0 to 25 dB"),
        (CameraSettings(0.1, 0, PixelFormat.MONO16), "pixel format Mono16 is not allowed"),
        (CameraSettings(0.1, roi=Roi(10, 0, 8, 12)), "ROI sample offset 10 px"),
    ],
)
def test_settings_outside_its_limits_are_refused(settings: CameraSettings, complaint: str) -> None:
    async def main() -> None:
        device = camera("sensors2019")
        await device.connect()
        with pytest.raises(OutOfRange, match=complaint):
            await device.configure(settings)
        with pytest.raises(DeviceError, match="not configured"):
            await device.arm(Trigger.SOFTWARE, 4)
        await device.close()

    virtually(main)


def test_calls_in_the_wrong_state_are_refused(profile: Callable[..., str]) -> None:
    async def main() -> None:
        device = camera(profile())
        with pytest.raises(DeviceError, match="not connected"):
            _ = device.info
        await device.disarm()
        await armed(device)
        with pytest.raises(DeviceBusy):
            await device.arm(Trigger.SOFTWARE, 4)
        with pytest.raises(DeviceBusy):
            await device.configure(CameraSettings(0.1))
        await device.disarm()
        with pytest.raises(DeviceError, match="not armed"):
            device.frames()
        await device.arm(Trigger.LINE, 4)
        with pytest.raises(DeviceError, match="not armed for software triggers"):
            await device.expose()
        await device.disarm()
        await device.arm(Trigger.SOFTWARE, 4)
        _, [frame] = await burst(device, 1)
        with pytest.raises(ValueError, match="needs C-contiguous uint8"):
            await device.unpack(frame, np.zeros((12, 17), np.uint8))
        await device.close()

    virtually(main)


def test_one_camera_a_bench(profile: Callable[..., str]) -> None:
    async def main() -> None:
        first, second = camera(profile(), bench="one"), camera(profile(), bench="one")
        await first.connect()
        with pytest.raises(DeviceBusy, match=r'bench = "\.\.\."'):
            await second.connect()
        await first.close()
        await second.connect()
        await second.close()

    virtually(main)


def test_it_says_what_it_is() -> None:
    async def main() -> None:
        device = camera("sensors2019", seed=5)
        await device.connect()
        info = device.info
        assert info.simulated
        assert (info.bands, info.samples, info.readout_s) == (12, 16, pytest.approx(0.0202))
        assert "derived-from-text, not measured" in info.firmware
        assert "seed 5" in info.serial
        assert info.triggers == frozenset(Trigger)
        await device.close()

    virtually(main)


def test_abilities_are_those_of_its_class() -> None:
    abilities = (
        "HardwareTriggered",
        "FreeRunning",
        "OverlapsReadout",
        "ForetellsEnd",
        "MeasuresTemperature",
        "ShowsScenes",
    )
    assert camera_backend.capabilities == abilities
    assert camera_backend.capabilities == abilities
    plain, overlapping = (camera("ideal", overlap=overlap) for overlap in (False, True))
    assert isinstance(plain, HardwareTriggered)
    assert isinstance(plain, FreeRunning)
    assert not isinstance(plain, OverlapsReadout)
    assert isinstance(overlapping, OverlappingCamera | OverlapsReadout)


def test_it_is_found_by_its_entry_point() -> None:
    backend = find(Role.CAMERA, "simulated")
    assert backend is camera_backend
    assert backend.virtual_time
    assert all(field.description for field in CameraOptions.model_fields.values())


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"scene": "foot"}, "there is no scene 'foot'; there are: amsler, cold-lamp, colour-checker"),
        ({"profile": "sensors2018"}, "there is no delay profile 'sensors2018'; there are: ideal, sensors2019"),
        ({"profile": "/none.json"}, "/none.json: cannot read the delay profile"),
        ({"exposure_range_s": (1, 0.1)}, "the smallest value comes first"),
        ({"seeds": 1}, "Extra inputs"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        CameraOptions(**options)


def test_it_is_shown_another_scene_between_two_acquisitions_and_only_then() -> None:
    async def main() -> None:
        device = camera("ideal", scene="dark")
        await device.connect()
        assert device.scene == "dark"
        await device.show("white")
        assert device.scene == "white"
        with pytest.raises(OutOfRange, match="there is no scene 'foot'"):
            await device.show("foot")
        await device.configure(CameraSettings(exposure_s=0.02))
        await device.arm(Trigger.SOFTWARE, 2)
        with pytest.raises(DeviceBusy, match="armed"):
            await device.show("dark")
        await device.close()

    virtually(main)

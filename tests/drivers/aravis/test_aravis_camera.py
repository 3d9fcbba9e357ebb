"""The real driver against the camera twin, over a real socket."""

import asyncio
import gc
import os
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aravis_twin import STEP, Twin, threads
from numpy.typing import NDArray

from scanhsi.clock import now_ns, run
from scanhsi.devices import (
    Camera,
    CameraSettings,
    Frame,
    FrameGap,
    FreeRunning,
    HardwareTriggered,
    OverlapsReadout,
    PixelFormat,
    Roi,
    Trigger,
)
from scanhsi.devices.errors import DeviceBusy, DeviceError, DeviceNotFound, OutOfRange, UnsupportedFeature
from scanhsi_aravis import AravisCamera, AravisOptions
from scanhsi_aravis.features import _snapped  # pyright: ignore[reportPrivateUsage]
from scanhsi_sim.scenes import load_scene

pytestmark = pytest.mark.twin

SMALL = CameraSettings(0.002, 0.0, PixelFormat.MONO8, Roi(64, 32, 256, 64))


def camera(twin: Twin, **options: Any) -> AravisCamera:
    return AravisCamera(AravisOptions(address=twin.address, **options))


@asynccontextmanager
async def opened(twin: Twin, settings: CameraSettings = SMALL, **options: Any) -> AsyncGenerator[AravisCamera]:
    """A connected and configured camera, closed in the end."""
    device = camera(twin, **options)
    await device.connect()
    try:
        await device.configure(settings)
        yield device
    finally:
        await device.close()


async def take(device: AravisCamera) -> Frame:
    """The next event, which has to be a frame."""
    async with asyncio.timeout(5):
        event = await anext(device.frames())
    assert isinstance(event, Frame), event
    return event


def expected(settings: CameraSettings) -> NDArray[Any]:
    """What the twin's scene shows at those settings."""
    roi = settings.roi or Roi(0, 0, 2048, 1088)
    bits = 8 if settings.pixel_format is PixelFormat.MONO8 else 12
    pixels = load_scene("testpattern", seed=0).render(
        STEP,
        STEP,
        exposure_s=settings.exposure_s,
        gain_db=settings.gain_db,
        shape=roi.shape,
        offset=(roi.band_offset, roi.sample_offset),
        bits=bits,
        index=0,
    )
    return pixels << 4 if settings.pixel_format is PixelFormat.MONO16 else pixels


def test_it_is_what_it_says(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            info = device.info
            assert (info.bands, info.samples, info.roi_step) == (1088, 2048, (2, 8))
            assert info.vendor == "Allied Vision Technologies"
            assert "Mako" in info.model
            assert info.simulated
            assert set(info.pixel_formats) == set(PixelFormat)
            assert (info.exposure.minimum, info.exposure.maximum) == (21e-6, 153.0)
            assert (info.gain.minimum, info.gain.maximum) == (0, 24)
            assert info.triggers == frozenset(Trigger)
            assert info.readout_s == pytest.approx(1 / 49.5, rel=1e-3)
            assert all(isinstance(device, kind) for kind in (Camera, FreeRunning, HardwareTriggered, OverlapsReadout))

    run(main())


@pytest.mark.parametrize("address", ["127.0.0.99", "no-such-camera"])
def test_nobody_there(twin: Twin, address: str) -> None:
    async def main() -> None:
        device = AravisCamera(AravisOptions(address=address))
        with pytest.raises(DeviceNotFound, match=rf"camera aravis {address}.*Try: power"):
            await device.connect()
        await device.close()
        assert not threads()

    run(main())


def test_controlled_by_another_program(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as first:
            second = camera(twin)
            with pytest.raises(DeviceBusy, match=r"another program controls it.*Try: close"):
                await second.connect()
            await first.arm(Trigger.SOFTWARE, 4)
            await first.expose()
            assert (await take(first)).index == 0

    run(main())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (CameraSettings(20e-6), r"exposure 2e-05 s is not allowed; allowed is 2.1e-05 to 153 s"),
        (CameraSettings(154), r"exposure 154 s is not allowed; allowed is 2.1e-05 to 153 s"),
        (CameraSettings(0.01, gain_db=24.1), r"gain 24.1 dB is not allowed; allowed is 0 to 24 dB"),
        (CameraSettings(0.01, roi=Roi(0, 0, 2056, 64)), r"ROI samples 2056 px is not allowed"),
        (CameraSettings(0.01, roi=Roi(0, 1080, 2048, 64)), r"ROI band offset 1080 px is not allowed"),
        (CameraSettings(0.01, roi=Roi(3, 0, 256, 64)), r"ROI sample offset 3 px.*in steps of 8"),
    ],
)
def test_out_of_range_is_refused(twin: Twin, settings: CameraSettings, message: str) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            with pytest.raises(OutOfRange, match=message):
                await device.configure(settings)

    run(main())


def test_aravis_checks_ranges_too(twin: Twin) -> None:
    """Off, as it is by default, Aravis writes any number."""

    async def main() -> None:
        async with opened(twin) as device:
            with pytest.raises(OutOfRange, match=r"Aravis says: .*ExposureTimeAbs"):
                device._session.configure(CameraSettings(1000, roi=SMALL.roi))  # pyright: ignore[reportPrivateUsage]

    run(main())


def test_options_narrow_what_is_allowed(twin: Twin) -> None:
    async def main() -> None:
        device = camera(twin, exposure_limits_s=(0.001, 0.1), gain_limits_db=(0, 6))
        await device.connect()
        assert (device.info.exposure.minimum, device.info.exposure.maximum) == (0.001, 0.1)
        with pytest.raises(OutOfRange, match="0 to 6 dB"):
            await device.configure(CameraSettings(0.01, gain_db=7))
        await device.close()
        with pytest.raises(OutOfRange, match="leaves nothing"):
            await camera(twin, gain_limits_db=(30, 40)).connect()

    run(main())


@pytest.mark.parametrize(("raw", "applied"), [(20.999999999999996, 21), (153e6 * (1 + 1e-12), 153e6), (20.9, 20.9)])
def test_a_limit_is_not_missed_by_rounding(raw: float, applied: float) -> None:
    assert _snapped(raw, 21, 153e6) == applied


def test_exposure_comes_back_as_rounded(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            applied = await device.configure(CameraSettings(0.0100004, 1.26, PixelFormat.MONO8))
            assert applied == CameraSettings(0.01, 1.2, PixelFormat.MONO8, Roi(0, 0, 2048, 1088)) or (
                applied.gain_db == pytest.approx(1.3)
            )
            shortest = await device.configure(CameraSettings(21e-6, 24.0, PixelFormat.MONO8))
            assert (shortest.exposure_s, shortest.gain_db) == (21e-6, 24.0)

    run(main())


@pytest.mark.parametrize("pixel_format", list(PixelFormat))
@pytest.mark.parametrize("roi", [None, Roi(520, 310, 1200, 400)])
def test_pixels_are_exact(twin: Twin, pixel_format: PixelFormat, roi: Roi | None) -> None:
    settings = CameraSettings(0.001, 0.0, pixel_format, roi)

    async def main() -> None:
        async with opened(twin, settings) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            await device.expose()
            frame = await take(device)
            assert frame.payload is not None
            assert frame.payload.size == pixel_format.payload_bytes(frame.shape)
            out: NDArray[Any] = np.zeros(frame.shape, pixel_format.dtype)
            await device.unpack(frame, out)
            await device.unpack(frame, None)
            np.testing.assert_array_equal(out, expected(settings))

    run(main())


@pytest.mark.parametrize("options", [{}, {"triggers_in_flight": 1}])
def test_software_triggers(twin: Twin, options: dict[str, Any]) -> None:
    async def main() -> None:
        async with opened(twin, **options) as device:
            await device.arm(Trigger.SOFTWARE, 12)
            before = twin.stats()
            started_ns = now_ns()
            exposures = [await device.expose() for _ in range(12)]
            frames = [await take(device) for _ in exposures]
            assert [exposure.index for exposure in exposures] == list(range(12))
            assert [frame.index for frame in frames] == list(range(12))
            for exposure, frame in zip(exposures, frames, strict=True):
                assert started_ns <= exposure.trigger_ns <= exposure.start_ns < exposure.end_ns
                assert exposure.end_ns - exposure.start_ns >= round((0.002 + 0.001) * 1e9)
                assert exposure.timed
                assert exposure.trigger_ns < (frame.first_byte_ns or 0) <= frame.received_ns
                # The twin stamps the start of exposure by the wall clock of this machine.
                assert frame.device_ns is not None
                assert frame.exposure_start_ns is None
            for exposure, following in pairwise(exposures):
                dead_ns = round(device.dead_time_s() * 1e9)
                assert following.trigger_ns >= exposure.end_ns + dead_ns
            stats = twin.stats()
            assert stats["exposures"] - before["exposures"] == 12
            assert stats["busy"] == before["busy"], "a trigger came while the sensor was busy"

    run(main())


def test_expose_returns_at_the_end_of_exposure(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin, CameraSettings(0.05, 0, PixelFormat.MONO8, SMALL.roi)) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            exposure = await device.expose()
            assert exposure.end_ns <= now_ns()
            assert exposure.end_ns >= exposure.trigger_ns + 51_000_000

    run(main())


def test_free_run(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            with pytest.raises(OutOfRange, match=r"frame period 0\.01 s is not allowed"):
                await device.set_frame_period(0.01)
            assert await device.set_frame_period(0.025) == pytest.approx(0.025, rel=1e-3)
            await device.arm(Trigger.FREE_RUN, 20)
            frames = [await take(device) for _ in range(20)]
            assert [frame.index for frame in frames] == list(range(20))
            stamps = np.array([frame.device_ns for frame in frames], np.int64)
            assert np.median(np.diff(stamps)) == pytest.approx(25e6, rel=0.02)
            starts = np.array([frame.exposure_start_ns for frame in frames], np.int64)
            first_bytes = np.array([frame.first_byte_ns for frame in frames], np.int64)
            assert (first_bytes - starts >= 2_000_000).all(), "a frame cannot come before its exposure is over"
            np.testing.assert_allclose(np.diff(starts), np.diff(stamps), atol=1e6)

    run(main())


def test_consumer_that_holds_every_buffer(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin, frame_timeout_s=0.3) as device:
            await device.arm(Trigger.FREE_RUN, 4)
            held = [await take(device) for _ in range(4)]
            copies = [np.array(frame.payload) for frame in held]
            await asyncio.sleep(0.8)  # longer than the watchdog's patience: the camera is not to blame
            assert all((frame.payload == copy).all() for frame, copy in zip(held, copies, strict=True))
            held.clear()
            async with asyncio.timeout(5):
                gap = await anext(device.frames())
                after = await anext(device.frames())
            assert isinstance(gap, FrameGap)
            assert gap.first == 4
            assert gap.count >= 5
            assert "buffer" in gap.reason
            assert isinstance(after, Frame)
            assert after.index == gap.first + gap.count

    run(main())


def test_hardware_trigger(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            assert device.shortest_trigger_period_s() == pytest.approx(1 / 49.5, rel=1e-3)
            await device.arm(Trigger.LINE, 8)
            with pytest.raises(DeviceError, match="armed for the trigger line"):
                await device.expose()
            for number in range(10):
                twin.pulse(number)
                frame = await take(device)
                assert frame.index == number
                del frame
                await asyncio.sleep(device.shortest_trigger_period_s())
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.2):
                    await anext(device.frames())

    run(main())


def test_lost_frames_are_gaps(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin, frame_timeout_s=0.1) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            await device.expose()
            assert (await take(device)).index == 0
            assert twin.tell("drop 1") == "ok"
            await device.expose()
            async with asyncio.timeout(5):
                gap = await anext(device.frames())
            assert isinstance(gap, FrameGap)
            assert (gap.first, gap.count) == (1, 1)
            await device.expose()
            assert (await take(device)).index == 2

    run(main())


def test_lost_frames_of_a_free_run_are_gaps(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            await device.arm(Trigger.FREE_RUN, 8)
            await take(device)
            assert twin.tell("drop 2") == "ok"
            seen, lost = 0, 0
            while seen < 8 or not lost:
                event = await anext(device.frames())
                if isinstance(event, FrameGap):
                    assert event.first == seen + lost + 1
                    lost += event.count
                else:
                    seen += 1
                    assert event.index == seen + lost
            assert lost == 2

    run(main())


def test_disarm_reports_what_will_not_come(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            stream = device.frames()
            assert twin.tell("drop 1") == "ok"
            await device.expose()
            await device.disarm()
            assert [event async for event in stream] == [FrameGap(0, 1, "disarmed before the frame came")]

    run(main())


def test_frames_stay_readable_after_disarm_and_close(twin: Twin) -> None:
    async def main() -> tuple[Frame, Frame]:
        async with opened(twin) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            stream = device.frames()
            for _ in range(2):
                await device.expose()
            await asyncio.sleep(0.1)
            ring = device._session._ring  # pyright: ignore[reportPrivateUsage]
            assert ring is not None
            await device.disarm()
            assert ring._stream is None, "views that die later would push to a stream that is gone"  # pyright: ignore[reportPrivateUsage]
            events = [event async for event in stream]
        first, second = events
        assert isinstance(first, Frame)
        assert isinstance(second, Frame)
        return first, second

    for frame in run(main()):
        assert frame.payload is not None
        np.testing.assert_array_equal(frame.payload.reshape(frame.shape), expected(SMALL))


def test_refusals(twin: Twin) -> None:
    async def main() -> None:
        device = camera(twin, trigger_line="Line9")
        with pytest.raises(DeviceError, match="not connected"):
            await device.configure(SMALL)
        with pytest.raises(DeviceError, match="not connected"):
            _ = device.info
        await device.disarm()
        await device.close()
        await device.connect()
        try:
            with pytest.raises(DeviceBusy, match="connected already"):
                await device.connect()
            with pytest.raises(DeviceError, match="not armed"):
                await device.expose()
            with pytest.raises(UnsupportedFeature, match="no trigger line.*Line9"):
                await device.arm(Trigger.LINE, 4)
            with pytest.raises(OutOfRange, match="buffers"):
                await device.arm(Trigger.SOFTWARE, 0)
            await device.arm(Trigger.SOFTWARE, 4)
            for attempt in (device.configure(SMALL), device.arm(Trigger.SOFTWARE, 4), device.set_frame_period(1)):
                with pytest.raises(DeviceBusy, match="disarm it first"):
                    await attempt
        finally:
            await device.close()
            await device.close()

    run(main())


def test_packet_size(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin, packet_size=1400) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            await device.expose()
            np.testing.assert_array_equal((await take(device)).payload, expected(SMALL).reshape(-1))
        with pytest.raises(OutOfRange, match="packet size 20000 is not allowed; the camera takes 500 to 9000"):
            await camera(twin, packet_size=20_000).connect()

    run(main())


def test_plain_udp_socket(twin: Twin) -> None:
    async def main() -> None:
        async with opened(twin, receive="socket", socket_buffer=1 << 20, frame_timeout_s=0.2) as device:
            await device.arm(Trigger.SOFTWARE, 4)
            frames: list[int] = []
            for _ in range(5):
                await device.expose()
                event = await anext(
                    device.frames()
                )  # the first frame may be lost: Aravis sizes the socket when it comes
                frames += [event.index] if isinstance(event, Frame) else []
            assert frames[-4:] == [1, 2, 3, 4]

    run(main())


def test_nothing_is_left_after_close(twin: Twin) -> None:
    async def cycle() -> None:
        async with opened(twin) as device:
            for _ in range(3):
                await device.arm(Trigger.SOFTWARE, 4)
                await device.expose()
                await take(device)
                await device.disarm()

    def used() -> tuple[int, int]:
        gc.collect()
        return len(os.listdir("/proc/self/fd")), int(Path("/proc/self/statm").read_text().split()[0])

    run(cycle())
    files, pages = used()
    for _ in range(3):
        run(cycle())
        assert not threads()
    files_after, pages_after = used()
    assert files_after == files
    assert pages_after - pages < 2000, "memory grows with every cycle"


def test_cancelled_anywhere_it_still_closes(twin: Twin) -> None:
    """Cancel the whole life of a camera after ever more turns of the loop; close has to leave nothing behind."""

    async def life(device: AravisCamera) -> None:
        await device.connect()
        await device.configure(SMALL)
        await device.arm(Trigger.SOFTWARE, 4)
        await device.expose()
        frame = await take(device)
        await device.unpack(frame, np.zeros(frame.shape, np.uint8))
        await device.expose()
        await device.disarm()

    async def cancelled_after(seconds: float) -> bool:
        device = camera(twin)
        task = asyncio.create_task(life(device))
        await asyncio.sleep(seconds)
        task.cancel()
        await asyncio.wait([task])
        await device.disarm()
        await device.close()
        assert len(asyncio.all_tasks()) == 1
        assert not threads()
        return not task.cancelled() and task.exception() is None

    finished = False
    after_s = 0.0
    while not finished:
        finished = run(cancelled_after(after_s))
        after_s = after_s * 1.25 + 0.0005
    assert after_s < 5


def test_close_can_be_cancelled(twin: Twin) -> None:
    async def main() -> None:
        for turns in range(4):
            device = camera(twin)
            await device.connect()
            await device.configure(SMALL)
            await device.arm(Trigger.FREE_RUN, 4)
            closing = asyncio.create_task(device.close())
            for _ in range(turns):
                await asyncio.sleep(0)
            closing.cancel()
            await asyncio.wait([closing])
            await device.close()
            assert not threads()

    run(main())

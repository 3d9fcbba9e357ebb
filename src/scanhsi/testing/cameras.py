"""The camera contract as tests; see `scanhsi.devices.camera`."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from scanhsi.clock import now_ns
from scanhsi.devices import Camera, CameraSettings, Frame, FrameGap, Roi, Trigger
from scanhsi.devices.errors import DeviceBusy, DeviceError, OutOfRange, UnsupportedFeature
from scanhsi.testing.camera_abilities import CameraAbilities
from scanhsi.testing.camera_cancelled import CameraCancelled
from scanhsi.testing.camera_suite import BUFFERS, CameraSuite
from scanhsi.testing.devices import refused


class CameraConformance(CameraCancelled, CameraAbilities, CameraSuite):
    """Inherit, write ``make``, and every test below runs on your camera; its attributes are those of `CameraSuite`."""

    # --- being there ------------------------------------------------------------------------------------------------------

    def test_info_is_not_known_before_connect(self) -> None:
        """``info`` raises `DeviceError` before ``connect``, or tells what needs no device; after it, it is whole."""

        async def use(camera: Camera) -> None:
            with suppress(DeviceError):
                assert camera.info.name
            await camera.connect()
            info = camera.info
            assert info.name
            assert min(info.bands, info.samples) > 0
            assert info.pixel_formats
            assert 0 < info.exposure.minimum <= info.exposure.maximum
            assert info.gain.minimum <= info.gain.maximum
            assert info.readout_s >= 0
            assert Trigger.SOFTWARE in info.triggers

        self.run(use, connected=False)

    def test_close_is_idempotent_and_may_come_at_any_time(self) -> None:
        """``disarm`` and ``close`` may be called in any state and any number of times."""

        async def use(camera: Camera) -> None:
            await camera.close()
            await camera.connect()
            await camera.disarm()
            await camera.disarm()
            await self.ready(camera)
            await camera.disarm()
            await camera.disarm()
            await camera.close()
            await camera.close()

        self.run(use, connected=False)

    def test_it_can_be_opened_again(self) -> None:
        """A device that was closed is free: for a new object, and after frames were taken."""
        for _ in range(2):

            async def use(camera: Camera) -> None:
                await self.ready(camera)
                await self.take(camera, 1)

            self.run(use)

    def test_a_second_user_is_refused(self) -> None:
        """`DeviceBusy` for whoever comes second; the first is not disturbed."""
        if not self.exclusive:
            pytest.skip("the device may be shared (exclusive = False)")

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            second = self.make()
            try:
                await refused("connecting a second object", (DeviceBusy,), second.connect())
            finally:
                await second.close()
            assert len(await self.take(camera, 2)) == 2

        self.run(use)

    # --- settings ---------------------------------------------------------------------------------------------------------

    def test_configure_tells_what_was_applied(self) -> None:
        """The answer has the region filled in; exposure and gain are those asked for, to the camera's own granularity."""

        async def use(camera: Camera) -> None:
            asked = self.settings(camera)
            applied = await camera.configure(asked)
            assert applied.roi == asked.roi
            assert applied.pixel_format == asked.pixel_format
            assert applied.exposure_s == pytest.approx(asked.exposure_s, rel=0.01, abs=camera.info.exposure.step)
            assert applied.gain_db == pytest.approx(asked.gain_db, abs=max(0.1, camera.info.gain.step))
            whole = await camera.configure(replace(asked, roi=None))
            assert whole.roi == Roi(0, 0, camera.info.samples, camera.info.bands)

        self.run(use)

    def test_what_is_not_allowed_is_refused_and_changes_nothing(self) -> None:
        """`OutOfRange` for each value outside ``info``; the settings before stay."""

        async def use(camera: Camera) -> None:
            info = camera.info
            good = await camera.configure(self.settings(camera))
            assert good.roi is not None
            wrong = [
                replace(good, exposure_s=info.exposure.maximum * 1.5 + 1),
                replace(good, exposure_s=info.exposure.minimum / 2),
                replace(good, gain_db=info.gain.maximum + 1),
                replace(good, roi=replace(good.roi, samples=info.samples + info.roi_step[1])),
                replace(good, roi=replace(good.roi, band_offset=info.bands)),
                replace(good, roi=replace(good.roi, bands=0)),
            ]
            for settings in wrong:
                await refused(f"configure({settings})", (OutOfRange,), camera.configure(settings))
            await camera.arm(Trigger.SOFTWARE, BUFFERS)
            event = (await self.take(camera, 1))[0]
            if isinstance(event, Frame):
                assert event.shape == good.roi.shape

        self.run(use)

    def test_not_while_armed(self) -> None:
        """An armed camera is not configured, nor armed again: a `DeviceError` says so, and frames still come."""

        async def use(camera: Camera) -> None:
            applied = await self.ready(camera)
            await refused("configure() of an armed camera", (DeviceError,), camera.configure(applied))
            assert len(await self.take(camera, 1)) == 1

        self.run(use)

    def test_a_trigger_it_does_not_know_is_refused(self) -> None:
        """`UnsupportedFeature`, and the camera is not armed."""

        async def use(camera: Camera) -> None:
            await camera.configure(self.settings(camera))
            unknown = [trigger for trigger in Trigger if trigger not in camera.info.triggers]
            for trigger in unknown:
                await refused(f"arm({trigger})", (UnsupportedFeature,), camera.arm(trigger, BUFFERS))
            await camera.arm(Trigger.SOFTWARE, BUFFERS)
            assert len(await self.take(camera, 1)) == 1

        self.run(use)

    # --- exposures and frames ---------------------------------------------------------------------------------------------

    def test_expose_returns_at_the_end_of_exposure(self) -> None:
        """Stamps in order; not before the end; counted from 0 since ``arm``."""

        async def use(camera: Camera) -> None:
            applied = await self.ready(camera)
            stream = camera.frames()
            for index in range(3):
                before = now_ns()
                exposure = await camera.expose()
                after = now_ns()
                assert exposure.index == index
                assert before <= exposure.trigger_ns <= exposure.start_ns < exposure.end_ns
                assert exposure.end_ns - exposure.start_ns >= round(applied.exposure_s * 1e9) - 1000
                assert exposure.end_ns <= after + 1, (
                    "expose() returned before the exposure had ended: the mirror would move"
                )
                await anext(stream)

        self.run(use)

    def test_each_exposure_is_one_frame_or_in_one_gap_in_order(self) -> None:
        """Exposing as fast as it can beside receiving: nothing is skipped, doubled or out of order."""
        count = 12

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            stream = camera.frames()
            told = list[int]()

            async def receive() -> None:
                while len(told) < count:
                    event = await anext(stream)
                    lost = isinstance(event, FrameGap)
                    told.extend(range(event.first, event.first + event.count) if lost else [event.index])
                    assert not lost or self.loses_frames, f"a gap: {event}"

            async with asyncio.TaskGroup() as group:
                group.create_task(receive())
                for _ in range(count):
                    await camera.expose()
            assert told == list(range(count))

        self.run(use)

    def test_counting_begins_anew_with_arm(self) -> None:
        """``index`` counts from 0 after each ``arm``, whatever the camera's own numbers do."""

        async def use(camera: Camera) -> None:
            for _ in range(2):
                await self.ready(camera)
                events = await self.take(camera, 2)
                assert [event.first if isinstance(event, FrameGap) else event.index for event in events] == [0, 1]
                await camera.disarm()

        self.run(use)

    def test_pixels_of_every_format(self) -> None:
        """``unpack`` fills (bands, samples) of the format's type; no value has more bits than the format; None is allowed."""

        async def use(camera: Camera) -> None:
            for pixel_format in camera.info.pixel_formats:
                applied = await camera.configure(self.settings(camera, pixel_format))
                assert applied.roi is not None
                await camera.arm(Trigger.SOFTWARE, BUFFERS)
                event = (await self.take(camera, 1))[0]
                if isinstance(event, Frame):
                    assert event.pixel_format is pixel_format
                    assert event.shape == applied.roi.shape
                    if event.payload is not None:
                        assert event.payload.nbytes >= pixel_format.payload_bytes(event.shape)
                        assert not event.payload.flags.writeable, "the payload is the camera's: it has to be read-only"
                    out = np.full(event.shape, 1, pixel_format.dtype)
                    await camera.unpack(event, out)
                    assert int(out.max()) < 2**pixel_format.bits
                    await camera.unpack(event, None)
                await camera.disarm()

        self.run(use)

    def test_a_frame_lives_as_long_as_it_is_looked_at(self) -> None:
        """A payload that is kept does not change under later frames, after ``disarm``, or after ``close``."""

        async def use(camera: Camera) -> None:
            await self.ready(camera, buffers=4)
            kept = [
                event for event in await self.take(camera, 2) if isinstance(event, Frame) and event.payload is not None
            ]
            before = [frame.payload.copy() for frame in kept if frame.payload is not None]
            for _ in range(6):
                await self.take(camera, 1)
            await camera.disarm()
            await camera.close()
            for frame, copy in zip(kept, before, strict=True):
                assert frame.payload is not None
                np.testing.assert_array_equal(frame.payload, copy)

        self.run(use)

    def test_frames_that_were_received_stay_after_disarm(self) -> None:
        """``disarm`` ends the stream behind what has been received."""

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            stream = camera.frames()
            await camera.expose()
            await asyncio.sleep(2 * camera.info.readout_s + 0.5)
            await camera.disarm()
            events = [event async for event in stream]
            assert len(events) == 1

        self.run(use)

    def test_holding_every_buffer_loses_frames_with_a_word(self) -> None:
        """Nobody lets frames go: those without a buffer end in gaps, and none is forgotten."""

        async def use(camera: Camera) -> None:
            buffers, count = 3, 7
            await self.ready(camera, buffers)
            stream, held, told = camera.frames(), list[Frame](), 0
            for _ in range(count):
                await camera.expose()
                await asyncio.sleep(2 * camera.info.readout_s + 0.05)
            async with asyncio.timeout(self.patience_s / 4):
                while told < count:
                    event = await anext(stream)
                    told += event.count if isinstance(event, FrameGap) else 1
                    if isinstance(event, Frame):
                        held.append(event)
            assert told == count

        self.run(use)

    # --- cancelled, wrong, and at the same time ---------------------------------------------------------------------------

    def test_a_cancelled_wait_loses_no_frame(self) -> None:
        """A deadline that ends a wait for a frame leaves the frame for the next wait."""

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            stream = camera.frames()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.02):
                    await anext(stream)
            await camera.expose()
            event = await anext(stream)
            assert (event.first if isinstance(event, FrameGap) else event.index) == 0

        self.run(use)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 1.1])
    def test_a_cancelled_exposure_leaves_a_camera_that_works(self, share: float) -> None:
        """``expose`` cancelled at some moment: ``disarm``, ``arm`` and the next exposures work."""

        async def use(camera: Camera) -> None:
            applied = await self.ready(camera)
            exposing = asyncio.ensure_future(camera.expose())
            await asyncio.sleep(share * applied.exposure_s)
            exposing.cancel()
            with suppress(asyncio.CancelledError):
                await exposing
            await camera.disarm()
            await self.ready(camera)
            assert len(await self.take(camera, 2)) == 2

        self.run(use)

    def test_out_of_order_calls_are_errors_of_the_tree(self) -> None:
        """Exposing a camera that is not armed, arming one that is not connected: a `DeviceError` that says so, and no hang."""

        async def use(camera: Camera) -> None:
            await refused("connect()less configure()", (DeviceError,), _configure(camera))
            await camera.connect()
            await camera.configure(self.settings(camera))
            await refused("expose() without arm()", (DeviceError,), camera.expose())

        async def _configure(camera: Camera) -> None:
            await camera.configure(CameraSettings(self.exposure_s))

        self.run(use, connected=False)

    def test_unpack_runs_beside_the_next_exposure(self) -> None:
        """Copying a frame does not hold up the camera."""

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            stream = camera.frames()
            await camera.expose()
            event = await anext(stream)
            async with asyncio.TaskGroup() as group:
                group.create_task(camera.expose())
                if isinstance(event, Frame):
                    group.create_task(camera.unpack(event, np.empty(event.shape, event.pixel_format.dtype)))
            await anext(stream)

        self.run(use)

"""Cameras that are cancelled, closed and opened anew; see `scanhsi.devices.camera`."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from scanhsi.clock import now_ns
from scanhsi.devices import Camera, Frame, FrameGap, Trigger
from scanhsi.devices.errors import DeviceError
from scanhsi.testing.camera_suite import BUFFERS, CameraSuite
from scanhsi.testing.devices import cancelled_after


class CameraCancelled(CameraSuite):
    """Whatever is cancelled, and whenever, what comes after it works."""

    @pytest.mark.parametrize("rounds", [0, 1, 3])
    @pytest.mark.parametrize("method", ["connect", "configure", "arm", "unpack", "disarm", "close"])
    def test_any_method_may_be_cancelled(self, method: str, rounds: int) -> None:
        """Cancelled after some rounds of the loop: ``disarm`` and ``close`` work, then the camera can be opened and used."""

        async def use(camera: Camera) -> None:
            if method != "connect":
                await camera.connect()
                await camera.configure(self.settings(camera))
            frame: Frame | None = None
            if method in ("unpack", "disarm", "close"):
                await camera.arm(Trigger.SOFTWARE, BUFFERS)
                event = (await self.take(camera, 1))[0]
                frame = event if isinstance(event, Frame) else None
            await cancelled_after(rounds, self._call(camera, method, frame))
            await camera.disarm()
            await camera.close()
            await camera.connect()
            await self.ready(camera)
            assert len(await self.take(camera, 1)) == 1

        self.run(use, connected=False)

    def _call(self, camera: Camera, method: str, frame: Frame | None) -> Coroutine[Any, Any, Any]:
        match method:
            case "configure":
                return camera.configure(self.settings(camera))
            case "arm":
                return camera.arm(Trigger.SOFTWARE, BUFFERS)
            case "unpack" if frame is not None:
                return camera.unpack(frame, np.empty(frame.shape, frame.pixel_format.dtype))
            case "disarm":
                return camera.disarm()
            case "close":
                return camera.close()
            case _:
                return camera.connect()

    @pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
    def test_a_cancelled_exposure_that_was_triggered_counts(self, share: float) -> None:
        """Its frame comes, before that of the next exposure, whose index says whether there is one."""

        async def use(camera: Camera) -> None:
            applied = await self.ready(camera)
            exposing = asyncio.ensure_future(camera.expose())
            await asyncio.sleep(share * applied.exposure_s)
            exposing.cancel()
            with suppress(asyncio.CancelledError):
                await exposing
            following = await camera.expose()
            assert following.index in ((1,) if exposing.done() and not exposing.cancelled() else (0, 1))
            stream, told = camera.frames(), list[int]()
            while len(told) <= following.index:
                event = await anext(stream)
                told += range(event.first, event.first + event.count) if isinstance(event, FrameGap) else [event.index]
            assert told == list(range(following.index + 1))

        self.run(use)

    def test_the_same_object_can_be_opened_anew(self) -> None:
        """``close``, of an armed camera too, and ``connect``: it is set up from the beginning, and counts from 0."""

        async def use(camera: Camera) -> None:
            for _ in range(2):
                await self.ready(camera)
                event = (await self.take(camera, 1))[0]
                assert (event.first if isinstance(event, FrameGap) else event.index) == 0
                await camera.close()
                with suppress(DeviceError):  # its name may be known without it
                    assert camera.info.name
                await camera.connect()

        self.run(use)

    def test_the_loop_goes_on_beside_an_exposure(self) -> None:
        """What blocks runs in a thread: other tasks run while an exposure lasts."""

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            rounds = 0

            async def count() -> None:
                nonlocal rounds
                while True:
                    await asyncio.sleep(self.exposure_s / 20)
                    rounds += 1

            counting = asyncio.ensure_future(count())
            await asyncio.sleep(0)
            for _ in range(5):
                await camera.expose()
            counting.cancel()
            assert rounds > 5, "the event loop stood still while the camera exposed"

        self.run(use)

    def test_frames_are_stamped_on_the_clock_of_the_loop(self) -> None:
        """``received_ns`` between the trigger and now; the first byte not after the last."""

        async def use(camera: Camera) -> None:
            await self.ready(camera)
            exposure = await camera.expose()
            event = await anext(camera.frames())
            if isinstance(event, Frame):
                assert exposure.trigger_ns <= event.received_ns <= now_ns() + 1
                assert event.first_byte_ns is None or event.first_byte_ns <= event.received_ns

        self.run(use)

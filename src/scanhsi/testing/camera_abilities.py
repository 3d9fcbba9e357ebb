"""The optional abilities of cameras as tests; see `scanhsi.devices.capabilities`. What a camera lacks is skipped."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise

import numpy as np
import pytest

from scanhsi.clock import now_ns
from scanhsi.devices import (
    Camera,
    ForetellsEnd,
    Frame,
    FreeRunning,
    HardwareTriggered,
    MeasuresTemperature,
    OverlapsReadout,
    ShowsScenes,
    Trigger,
)
from scanhsi.devices.errors import DeviceBusy, OutOfRange
from scanhsi.testing.camera_suite import BUFFERS, CameraSuite
from scanhsi.testing.devices import refused


class CameraAbilities(CameraSuite):
    """One test an ability."""

    def test_free_running(self) -> None:
        """`FreeRunning`: the period is as asked or longer, is kept, and frames tell the start of their exposure."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, FreeRunning) or Trigger.FREE_RUN not in camera.info.triggers:
                pytest.skip("it does not free-run")
            applied = await camera.configure(self.settings(camera))
            asked_s = max(4 * applied.exposure_s, 4 * camera.info.readout_s, 0.05)
            period_s = await camera.set_frame_period(asked_s)
            assert period_s == pytest.approx(asked_s, rel=0.02)
            await camera.arm(Trigger.FREE_RUN, BUFFERS)
            stream = camera.frames()
            events = [await anext(stream) for _ in range(6)]
            starts = [event.exposure_start_ns for event in events if isinstance(event, Frame)]
            assert None not in starts
            if not self.loses_frames:
                distances = np.diff([start for start in starts if start is not None]) * 1e-9
                np.testing.assert_allclose(np.median(distances), period_s, rtol=0.05)

        self.run(use)

    def test_a_frame_period_that_is_too_short_is_refused(self) -> None:
        """`FreeRunning`: `OutOfRange` for a period that exposure and read-out do not allow."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, FreeRunning) or Trigger.FREE_RUN not in camera.info.triggers:
                pytest.skip("it does not free-run")
            applied = await camera.configure(self.settings(camera))
            short_s = min(applied.exposure_s, camera.info.readout_s or applied.exposure_s) / 100
            await refused(f"set_frame_period({short_s:g})", (OutOfRange,), camera.set_frame_period(short_s))

        self.run(use)

    def test_hardware_triggers(self) -> None:
        """`HardwareTriggered`: the shortest period leaves room for the exposure or the read-out; without a pulse nothing comes."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, HardwareTriggered) or Trigger.LINE not in camera.info.triggers:
                pytest.skip("it takes no pulses")
            applied = await camera.configure(self.settings(camera))
            period_s = camera.shortest_trigger_period_s()
            assert math.isfinite(period_s)
            assert period_s >= applied.exposure_s * 0.999
            await camera.arm(Trigger.LINE, BUFFERS)
            stream = camera.frames()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.2):
                    await anext(stream)
            await camera.disarm()

        self.run(use)

    def test_dead_time(self) -> None:
        """`OverlapsReadout`: no exposure begins before the dead time after the one before is over."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, OverlapsReadout):
                pytest.skip("it does not say that it overlaps")
            await self.ready(camera)
            dead_s = camera.dead_time_s()
            assert 0 <= dead_s < math.inf
            exposures = [await camera.expose() for _ in range(4)]
            gaps = [later.start_ns - earlier.end_ns for earlier, later in pairwise(exposures)]
            assert min(gaps) >= 0, "exposures overlap each other"

        self.run(use)

    def test_the_end_is_foretold(self) -> None:
        """`ForetellsEnd`: told once, while the exposure lasts, and it is the end that is returned."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, ForetellsEnd):
                pytest.skip("it does not foretell the end of an exposure")
            await self.ready(camera)
            told = list[tuple[int, int]]()
            exposure = await camera.expose_foretold(lambda end_ns: told.append((end_ns, now_ns())))
            ((end_ns, at_ns),) = told
            assert end_ns == exposure.end_ns
            assert at_ns <= end_ns + 1 or not self.virtual, "told after the end"
            assert (await anext(camera.frames())) is not None

        self.run(use)

    def test_temperature(self) -> None:
        """`MeasuresTemperature`: degrees Celsius, or None; before settings are made, and between acquisitions."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, MeasuresTemperature):
                pytest.skip("it does not measure its temperature")
            first = await camera.temperature_c()
            await self.ready(camera)
            await self.take(camera, 1)
            await camera.disarm()
            for warmth in (first, await camera.temperature_c()):
                assert warmth is None or -100 < warmth < 150

        self.run(use)

    def test_scenes(self) -> None:
        """`ShowsScenes`: each scene by its name, no other; not while armed."""

        async def use(camera: Camera) -> None:
            if not isinstance(camera, ShowsScenes):
                pytest.skip("it shows no scenes")
            assert camera.scene in camera.scenes
            await refused("show('no such scene')", (OutOfRange,), camera.show("no such scene"))
            await camera.show(camera.scene)
            await self.ready(camera)
            await refused("show() while armed", (DeviceBusy,), camera.show(camera.scene))

        self.run(use)

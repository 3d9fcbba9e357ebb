"""What the real driver does when its camera, or another program that held it, vanishes. Each test has a twin of its own."""

import asyncio
from pathlib import Path

import numpy as np
import pytest
from aravis_checks import SLACK_S, SMALL, check_lost_for_good, check_threads, ready, until_error
from aravis_twin import Twin

from scanhsi.clock import now_ns, run
from scanhsi.devices import CameraSettings, Frame, PixelFormat, Trigger
from scanhsi.devices.errors import DeviceError, DeviceLost
from scanhsi_aravis.camera import ANSWER_S

pytestmark = pytest.mark.twin


@pytest.mark.parametrize("trigger", [Trigger.FREE_RUN, Trigger.LINE])
def test_killed_while_frames_are_awaited(own_twin: Twin, trigger: Trigger) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(trigger, 4)
        held = await anext(device.frames()) if trigger is Trigger.FREE_RUN else None
        own_twin.kill()
        error, waited_s = await until_error(device)
        assert isinstance(error, DeviceLost)
        assert "camera aravis 127.0.0.1" in str(error)
        assert waited_s < device.lost_after_s + SLACK_S
        with pytest.raises(DeviceError):
            await device.expose()
        await device.close()
        check_threads()
        if isinstance(held, Frame):
            assert held.payload is not None
            assert np.count_nonzero(held.payload), "views outlive their camera"

    run(main())


def test_killed_during_exposure(own_twin: Twin) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.configure(CameraSettings(0.3, 0, PixelFormat.MONO8, SMALL.roi))
        await device.arm(Trigger.SOFTWARE, 4)
        exposing = asyncio.create_task(device.expose())
        await asyncio.sleep(0.1)
        own_twin.kill()
        exposure = await exposing  # the trigger was confirmed; that the frame will not come is not known yet
        error, _ = await until_error(device)
        assert isinstance(error, DeviceLost)
        assert now_ns() - exposure.end_ns < (device.lost_after_s + SLACK_S) * 1e9
        await check_lost_for_good(device)

    run(main())


def test_killed_before_a_trigger(own_twin: Twin) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(Trigger.SOFTWARE, 4)
        own_twin.kill()
        started_ns = now_ns()
        with pytest.raises(DeviceLost):
            await device.expose()
        assert now_ns() - started_ns < (ANSWER_S + SLACK_S) * 1e9
        await check_lost_for_good(device)

    run(main())


def test_killed_while_idle_and_back_again(own_twin: Twin, tmp_path: Path) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        own_twin.kill()
        with pytest.raises(DeviceLost):
            await device.configure(SMALL)
        started_ns = now_ns()
        await device.close()
        assert now_ns() - started_ns < 1e9, "close waits for a camera that is gone"
        check_threads()
        (tmp_path / "again").mkdir()
        back = Twin(tmp_path / "again")
        try:  # while Aravis still says goodbye to the old one
            await device.connect()
            await device.configure(SMALL)
            await device.arm(Trigger.SOFTWARE, 4)
            for index in range(20):
                await device.expose()
                frame = await anext(device.frames())
                assert isinstance(frame, Frame)
                assert frame.index == index
            await device.close()
        finally:
            back.close()

    run(main())

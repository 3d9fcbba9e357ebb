"""What the real driver does when its camera, or another program that held it, vanishes. Each test has a twin of its own."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from aravis_twin import Twin, threads

from scanhsi.clock import now_ns, run
from scanhsi.devices import CameraSettings, Frame, FrameGap, PixelFormat, Roi, Trigger
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceTimeout
from scanhsi_aravis import AravisCamera, AravisOptions
from scanhsi_aravis.camera import ANSWER_S

pytestmark = pytest.mark.twin

SMALL = CameraSettings(0.002, 0.0, PixelFormat.MONO8, Roi(64, 32, 256, 64))
SLACK_S = 1.5
"""For a busy machine; the deadlines themselves are the driver's."""


async def ready(twin: Twin) -> AravisCamera:
    device = AravisCamera(AravisOptions(address=twin.address, frame_timeout_s=0.2))
    await device.connect()
    await device.configure(SMALL)
    return device


async def until_error(device: AravisCamera) -> tuple[DeviceError, float]:
    """What ends the frames, and after how many seconds without any."""
    last_ns = now_ns()
    try:
        async with asyncio.timeout(20):
            async for _ in device.frames():
                last_ns = now_ns()
    except DeviceError as error:
        return error, (now_ns() - last_ns) * 1e-9
    raise AssertionError("the frames ended without an error")


async def check_lost_for_good(device: AravisCamera) -> None:
    """After `DeviceLost` every call says so, and closing is quick."""
    with pytest.raises(DeviceLost):
        await device.expose()
    with pytest.raises(DeviceLost):
        await anext(device.frames())
    started_ns = now_ns()
    await device.disarm()
    with pytest.raises(DeviceLost):
        await device.expose()
    with pytest.raises(DeviceLost):
        await device.configure(SMALL)
    await device.close()
    await device.close()
    assert now_ns() - started_ns < 1e9
    check_threads()
    with pytest.raises(DeviceError, match="not connected"):
        await device.configure(SMALL)


def check_threads() -> None:
    """None of ours; Aravis' own say goodbye to a camera that does not answer, for a while."""
    assert not [name for name in threads() if not name.startswith("arv_")]


@pytest.mark.parametrize("trigger", [Trigger.FREE_RUN, Trigger.LINE])
def test_killed_while_frames_are_awaited(own_twin: Twin, trigger: Trigger) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(trigger, 4)
        if trigger is Trigger.FREE_RUN:
            for _ in range(5):
                await anext(device.frames())
        own_twin.kill()
        error, waited_s = await until_error(device)
        assert isinstance(error, DeviceLost)
        assert "camera aravis 127.0.0.1" in str(error)
        assert waited_s < device.lost_after_s + SLACK_S
        with pytest.raises(DeviceError):
            await device.expose()
        await device.close()
        check_threads()

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


def test_a_short_freeze_is_survived(own_twin: Twin) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(Trigger.SOFTWARE, 4)
        await device.expose()
        assert isinstance(await anext(device.frames()), Frame)
        own_twin.tell("freeze")
        asyncio.get_running_loop().call_later(1.0, own_twin.tell, "thaw")
        await device.expose()
        events = [await anext(device.frames())]
        await device.expose()
        events.append(await anext(device.frames()))
        assert [e.first if isinstance(e, FrameGap) else e.index for e in events] == [1, 2]
        await device.close()

    run(main())


def test_a_camera_that_answers_but_sends_nothing(own_twin: Twin) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(Trigger.FREE_RUN, 4)
        for _ in range(3):
            await anext(device.frames())
        own_twin.tell("drop 100000")
        error, waited_s = await until_error(device)
        assert isinstance(error, DeviceTimeout)
        assert "packet_size" in str(error)
        assert waited_s < device.lost_after_s + SLACK_S
        own_twin.tell("drop 0")
        await device.disarm()
        await device.arm(Trigger.FREE_RUN, 4)  # it was not lost
        assert isinstance(await anext(device.frames()), Frame)
        await device.close()

    run(main())


def test_frame_ids_wrap(own_twin: Twin) -> None:
    async def main() -> None:
        device = await ready(own_twin)
        await device.set_frame_period(device.shortest_trigger_period_s())
        await device.arm(Trigger.FREE_RUN, 16)
        seen: list[tuple[int, int]] = []
        async for event in device.frames():
            assert isinstance(event, Frame), event
            seen.append((event.index, event.frame_id))
            if len(seen) == 200:
                break
        await device.close()
        indices, ids = zip(*seen, strict=True)
        assert indices == tuple(range(200))
        assert {65535, 1} <= set(ids)
        assert 0 not in ids

    run(main())


CRASH = """
import asyncio, os, sys
from scanhsi.devices import Trigger
from scanhsi_aravis import AravisCamera, AravisOptions

async def main():
    device = AravisCamera(AravisOptions(address=sys.argv[1]))
    await device.connect()
    await device.arm(Trigger.FREE_RUN, 4)
    await anext(device.frames())
    os.kill(os.getpid(), 9)

asyncio.run(main())
"""


def test_reopened_after_a_program_died_with_it(own_twin: Twin) -> None:
    dead = subprocess.run([sys.executable, "-c", CRASH, own_twin.address], check=False)
    assert dead.returncode == -9, "the program was to die with the camera in its hands"

    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(Trigger.SOFTWARE, 4)
        exposure = await device.expose()
        frame = await anext(device.frames())
        assert isinstance(frame, Frame)
        assert (exposure.index, frame.index) == (0, 0)
        await device.close()

    run(main())


def test_views_survive_a_lost_camera(own_twin: Twin) -> None:
    async def main() -> Frame:
        device = await ready(own_twin)
        await device.arm(Trigger.FREE_RUN, 4)
        frame = await anext(device.frames())
        own_twin.kill()
        with pytest.raises(DeviceLost):
            await device.disarm()
        await device.close()
        assert isinstance(frame, Frame)
        return frame

    frame = run(main())
    assert frame.payload is not None
    assert np.count_nonzero(frame.payload) > 0
    assert not os.path.exists(f"/proc/{own_twin.process.pid}")


def test_control_taken_away(own_twin: Twin) -> None:
    """Aravis tells it by a signal in its heartbeat thread, after seconds; here the signal is sent by hand."""

    async def main() -> None:
        device = await ready(own_twin)
        await device.arm(Trigger.SOFTWARE, 4)
        waiting = asyncio.ensure_future(anext(device.frames()))
        await asyncio.to_thread(device._session._device.emit, "control-lost")  # pyright: ignore[reportPrivateUsage]
        with pytest.raises(DeviceLost, match="control of it was lost"):
            await waiting
        await check_lost_for_good(device)

    run(main())

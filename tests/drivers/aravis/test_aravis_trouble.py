"""Troubles that the camera survives, over a real socket: all tests share one twin."""

import asyncio
import subprocess
import sys

import pytest
from aravis_checks import SLACK_S, check_lost_for_good, ready, until_error
from aravis_twin import Twin

from scanhsi.clock import run
from scanhsi.devices import Frame, FrameGap, Trigger
from scanhsi.devices.errors import DeviceLost, DeviceTimeout

pytestmark = pytest.mark.twin


def test_frame_ids_wrap(twin: Twin) -> None:
    async def main() -> None:
        device = await ready(twin)
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
        assert {65535, 1} <= set(ids), (
            "the fake counts from 65400 when it is started: this test has to be the first of its twin"
        )
        assert 0 not in ids

    run(main())


def test_a_short_freeze_is_survived(twin: Twin) -> None:
    async def main() -> None:
        device = await ready(twin)
        await device.arm(Trigger.SOFTWARE, 4)
        await device.expose()
        assert isinstance(await anext(device.frames()), Frame)
        twin.tell("freeze")
        asyncio.get_running_loop().call_later(1.0, twin.tell, "thaw")
        await device.expose()
        events = [await anext(device.frames())]
        await device.expose()
        events.append(await anext(device.frames()))
        assert [e.first if isinstance(e, FrameGap) else e.index for e in events] == [1, 2]
        await device.close()

    run(main())


def test_a_camera_that_answers_but_sends_nothing(twin: Twin) -> None:
    async def main() -> None:
        device = await ready(twin)
        await device.arm(Trigger.FREE_RUN, 4)
        for _ in range(3):
            await anext(device.frames())
        twin.tell("drop 100000")
        error, waited_s = await until_error(device)
        assert isinstance(error, DeviceTimeout)
        assert "packet_size" in str(error)
        assert waited_s < device.lost_after_s + SLACK_S
        twin.tell("drop 0")
        await device.disarm()
        await device.arm(Trigger.FREE_RUN, 4)  # it was not lost
        assert isinstance(await anext(device.frames()), Frame)
        await device.close()

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


def test_reopened_after_a_program_died_with_it(twin: Twin) -> None:
    dead = subprocess.run([sys.executable, "-c", CRASH, twin.address], check=False)
    assert dead.returncode == -9, "the program was to die with the camera in its hands"

    async def main() -> None:
        device = await ready(twin)
        await device.arm(Trigger.SOFTWARE, 4)
        exposure = await device.expose()
        frame = await anext(device.frames())
        assert isinstance(frame, Frame)
        assert (exposure.index, frame.index) == (0, 0)
        await device.close()

    run(main())


def test_control_taken_away(twin: Twin) -> None:
    """Aravis tells it by a signal in its heartbeat thread, after seconds; here the signal is sent by hand."""

    async def main() -> None:
        device = await ready(twin)
        await device.arm(Trigger.SOFTWARE, 4)
        waiting = asyncio.ensure_future(anext(device.frames()))
        await asyncio.to_thread(device._session._device.emit, "control-lost")  # pyright: ignore[reportPrivateUsage]
        with pytest.raises(DeviceLost, match="control of it was lost"):
            await waiting
        await check_lost_for_good(device)

    run(main())

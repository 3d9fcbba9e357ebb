"""Arrivals, triggers and deadlines between arm and disarm, in virtual time and without a camera."""

import asyncio

import numpy as np
import pytest

from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices import CameraSettings, Frame, FrameGap, PixelFormat, Roi, Trigger
from scanhsi.devices.errors import DeviceLost
from scanhsi_aravis.armed import Armed, Times
from scanhsi_aravis.order import Pending
from scanhsi_aravis.stream import Arrival

MS = 1_000_000
SETTINGS = CameraSettings(0.01, 0, PixelFormat.MONO8, Roi(0, 0, 8, 2))
TIMES = Times(exposure=10 * MS, margin=1 * MS, dead=5 * MS, silence=100 * MS)


def arrival(frame_id: int, *, first_byte_ns: int | None = None, stamped_ns: int | None = None) -> Arrival:
    payload = np.zeros(16, np.uint8)
    return Arrival(now_ns(), payload, frame_id=frame_id, first_byte_ns=first_byte_ns, stamped_ns=stamped_ns)


def trigger(armed: Armed) -> Pending:
    """A trigger that the camera confirms at once."""
    pending = Pending()
    armed.triggered(pending, now_ns())
    armed.trigger_confirmed(pending, now_ns())
    return pending


def queued(armed: Armed) -> list[Frame | FrameGap]:
    """What the consumer will get."""
    return list(armed.channel._events)  # pyright: ignore[reportPrivateUsage]


async def must_wait(armed: Armed, in_flight: int) -> bool:
    """Whether the next trigger has to wait for a frame."""
    try:
        async with asyncio.timeout(0.001):
            await armed.may_trigger(in_flight)
    except TimeoutError:
        return True
    return False


def test_the_sensor_is_given_its_time() -> None:
    async def main() -> None:
        armed = Armed(Trigger.SOFTWARE, SETTINGS, TIMES)
        pending = trigger(armed)
        assert pending.end_ns == now_ns() + 11 * MS
        armed.arrived(arrival(1))
        assert await armed.may_trigger(2) == pending.end_ns + 5 * MS

    run_virtual(main())


def test_the_first_frame_is_waited_for_and_then_two_may_be_in_flight() -> None:
    async def main() -> None:
        armed = Armed(Trigger.SOFTWARE, SETTINGS, TIMES)
        assert not await must_wait(armed, 2)
        trigger(armed)
        assert await must_wait(armed, 2)
        armed.arrived(arrival(1))
        trigger(armed)
        assert not await must_wait(armed, 2)
        assert await must_wait(armed, 1)
        trigger(armed)
        assert await must_wait(armed, 2)
        armed.arrived(Arrival(now_ns(), problem="packets were lost"))
        assert await must_wait(armed, 2), "after a loss it is not known which frame comes next"
        armed.arrived(arrival(3))
        assert not await must_wait(armed, 1)
        assert [e.first if isinstance(e, FrameGap) else e.index for e in queued(armed)] == [0, 1, 2]

    run_virtual(main())


def test_a_frame_that_does_not_come_is_overdue_at_its_deadline() -> None:
    async def main() -> None:
        armed = Armed(Trigger.SOFTWARE, SETTINGS, TIMES)
        pending = trigger(armed)
        assert armed.deadline_ns() == pending.end_ns + 100 * MS
        await asyncio.sleep(0.1109)
        assert not armed.overdue()
        await asyncio.sleep(0.0002)
        assert armed.overdue()
        armed.forgive()
        assert [(gap.first, gap.count) for gap in queued(armed) if isinstance(gap, FrameGap)] == [(0, 1)]
        assert not armed.overdue()
        assert not await must_wait(armed, 1)

    run_virtual(main())


def test_an_unconfirmed_trigger_is_never_overdue() -> None:
    """The control thread is still talking to the camera: its error is the one to raise."""

    async def main() -> None:
        armed = Armed(Trigger.SOFTWARE, SETTINGS, TIMES)
        pending = Pending()
        armed.triggered(pending, now_ns())
        await asyncio.sleep(10)
        assert not armed.overdue()
        armed.trigger_refused(pending)
        assert not await must_wait(armed, 1)

    run_virtual(main())


def test_free_run_is_overdue_after_silence() -> None:
    async def main() -> None:
        armed = Armed(Trigger.FREE_RUN, SETTINGS, TIMES)
        await asyncio.sleep(0.099)
        armed.arrived(arrival(1))
        await asyncio.sleep(0.099)
        assert not armed.overdue()
        armed.arrived(Arrival(now_ns(), problem="packets were lost"))  # broken frames are no silence
        await asyncio.sleep(0.099)
        assert not armed.overdue()
        await asyncio.sleep(0.002)
        assert armed.overdue()

    run_virtual(main())


def test_start_of_exposure_of_what_the_camera_starts() -> None:
    async def main() -> None:
        await asyncio.sleep(1)
        armed = Armed(Trigger.LINE, SETTINGS, TIMES)
        armed.arrived(arrival(1, first_byte_ns=500 * MS))
        armed.arrived(arrival(2, first_byte_ns=600 * MS, stamped_ns=585 * MS))
        armed.arrived(arrival(3))
        assert [frame.exposure_start_ns for frame in queued(armed) if isinstance(frame, Frame)] == [
            490 * MS,
            585 * MS,
            None,
        ]

    run_virtual(main())


def test_failure_reaches_everybody_who_waits() -> None:
    async def main() -> None:
        armed = Armed(Trigger.SOFTWARE, SETTINGS, TIMES)
        trigger(armed)
        waiting = asyncio.gather(armed.may_trigger(1), anext(armed.channel), return_exceptions=True)
        await asyncio.sleep(0.001)
        error = DeviceLost("unplugged")
        armed.fail(error)
        armed.fail(DeviceLost("again"))
        assert await waiting == [error, error]
        armed.arrived(arrival(1))
        with pytest.raises(DeviceLost, match="unplugged"):
            await anext(armed.channel)

    run_virtual(main())


def test_disarming_accounts_for_every_exposure() -> None:
    async def main() -> None:
        armed = Armed(Trigger.SOFTWARE, SETTINGS, TIMES)
        trigger(armed)
        armed.arrived(arrival(1))
        trigger(armed)
        trigger(armed)
        armed.finish()
        events = [event async for event in armed.channel]
        assert [e.first if isinstance(e, FrameGap) else e.index for e in events] == [0, 1, 2]
        armed.finish()

    run_virtual(main())

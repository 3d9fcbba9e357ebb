"""What happens to frames between a camera and whoever waits for them."""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from scanhsi.clock import now_ns
from scanhsi.devices import Frame, FrameChannel, FrameEvent, FrameGap, FrameStream
from scanhsi.testing.faults import Fault, Faults, Kind, for_ever_s
from scanhsi.testing.witness import Witness

PACKETS_MISSING: Final = "3 packets missing"
"""Reason of the gap of an incomplete frame."""

_LAST_ID: Final = 65535
_OF_FRAMES: Final = (
    Kind.CAMERA_SILENT,
    Kind.FRAME_LOST,
    Kind.FRAME_INCOMPLETE,
    Kind.FRAME_LATE,
    Kind.FRAME_ID_WRAPS,
    Kind.METADATA_STALE,
    Kind.TEMPERATURE_DRIFTS,
    Kind.FRAME_TWICE,
    Kind.FRAMES_SWAPPED,
)


@dataclass(slots=True)
class Shutter:
    """Exposures of one armed period.

    Attributes:
        exposure_ns: As configured.
        extra_ns: By how much each exposure was longer, in order.
        disarmed: Nothing is held up any more.
    """

    exposure_ns: int = 0
    extra_ns: list[int] = field(default_factory=list[int])
    disarmed: asyncio.Event = field(default_factory=asyncio.Event)

    def longer(self, extra_ns: int) -> None:
        """The next exposure is so much longer."""
        self.extra_ns.append(extra_ns)

    def shut_ns(self, frame: Frame) -> int:
        """When the exposure of a frame ended."""
        extra_ns = self.extra_ns[frame.index] if frame.index < len(self.extra_ns) else 0
        return (frame.exposure_start_ns or 0) + self.exposure_ns + extra_ns

    async def wait_until_ns(self, when_ns: float) -> None:
        """Wait, but not beyond the disarming."""
        if when_ns <= now_ns() or self.disarmed.is_set():
            return
        try:
            async with asyncio.timeout_at(when_ns * 1e-9):
                await self.disarmed.wait()
        except TimeoutError:
            pass


@dataclass(slots=True)
class _Course:
    """What the frames so far have led to."""

    silent_until_ns: float = 0.0
    wrapped_at: int | None = None
    held: FrameEvent | None = None
    last_id: int = 0
    last_device_ns: int | None = None


async def pump(stream: FrameStream, channel: FrameChannel, shutter: Shutter, faults: Faults, witness: Witness) -> None:
    """Bring what a camera sends to a channel, with the faults of a plan, until the stream ends."""
    kinds = [kind for kind in _OF_FRAMES if faults.has(kind)]
    course = _Course()
    try:
        async for event in stream:
            if isinstance(event, FrameGap):
                channel.put(event)
                continue
            _see(event, shutter, witness)
            due = {kind: fault for kind in kinds if (fault := faults.due(kind)) is not None}
            await shutter.wait_until_ns(shutter.shut_ns(event))
            if Kind.FRAME_LATE in due:
                await shutter.wait_until_ns(now_ns() + for_ever_s(due[Kind.FRAME_LATE].for_s) * 1e9)
            for passed in _passed(event, due, course, witness):
                channel.put(passed)
                del passed
            del event  # whoever takes the frame alone decides how long its buffer is in use
        if course.held is not None:
            channel.put(course.held)
        channel.close()
    except Exception as error:
        channel.fail(error)
    finally:
        course.held = None


def _see(frame: Frame, shutter: Shutter, witness: Witness) -> None:
    if (start_ns := frame.exposure_start_ns) is not None:
        witness.exposed(start_ns, start_ns + shutter.exposure_ns, shutter.shut_ns(frame))
    try:
        weakref.finalize(frame, witness.gone).atexit = False
    except TypeError:  # frames of this driver cannot be followed
        return
    witness.came()


def _passed(frame: Frame, due: dict[Kind, Fault], course: _Course, witness: Witness) -> Iterable[FrameEvent]:
    """What arrives of a frame, and of one before that was held back."""
    if (fault := due.get(Kind.TEMPERATURE_DRIFTS)) is not None and frame.exposure_start_ns is not None:
        witness.warm_from(frame.exposure_start_ns, fault.by)
    if (fault := due.get(Kind.CAMERA_SILENT)) is not None:
        course.silent_until_ns = now_ns() + for_ever_s(fault.for_s) * 1e9
    if now_ns() < course.silent_until_ns or Kind.FRAME_LOST in due:
        return
    if Kind.FRAME_INCOMPLETE in due:
        yield FrameGap(frame.index, 1, PACKETS_MISSING)
        return
    _renumber(frame, due, course)
    if (sight := witness.sights.get(frame.exposure_start_ns or 0)) is not None:
        sight.frame_id = frame.frame_id
    if Kind.FRAMES_SWAPPED in due and course.held is None:
        course.held = frame
        return
    yield frame
    if Kind.FRAME_TWICE in due:
        yield frame
    if course.held is not None:
        held, course.held = course.held, None
        yield held


def _renumber(frame: Frame, due: dict[Kind, Fault], course: _Course) -> None:
    if Kind.FRAME_ID_WRAPS in due:
        course.wrapped_at = frame.index
    if course.wrapped_at is not None:
        frame.frame_id = (_LAST_ID - 1 + frame.index - course.wrapped_at) % _LAST_ID + 1
    told = frame.frame_id, frame.device_ns
    if Kind.METADATA_STALE in due:
        frame.frame_id, frame.device_ns = course.last_id, course.last_device_ns
    course.last_id, course.last_device_ns = told

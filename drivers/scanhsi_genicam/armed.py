"""What happens between ``arm`` and ``disarm``, on the event loop: arrivals become frames and gaps, deadlines are kept."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass

from scanhsi.clock import now_ns
from scanhsi.devices.camera import CameraSettings
from scanhsi.devices.errors import DeviceError
from scanhsi.devices.frames import Frame, FrameChannel, FrameGap
from scanhsi_genicam.session import Arrival


@dataclass(slots=True)
class Pending:
    """A trigger whose frame has not come; loop clock, ns. Before the camera has confirmed it, ``due_ns`` is None."""

    index: int = -1
    sent_ns: int = 0
    end_ns: int = 0
    due_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Times:
    """Durations of one arming, ns: exposure with its margin, read-out, and how late a frame may be."""

    exposure: int
    readout: int
    silence: int


class Armed:
    """State of one arming. Event loop only."""

    def __init__(self, settings: CameraSettings, times: Times) -> None:
        if settings.roi is None:
            raise ValueError("settings as applied have a ROI")
        self.channel = FrameChannel()
        self.error: DeviceError | None = None
        self._shape, self._pixel_format = settings.roi.shape, settings.pixel_format
        self._times = times
        self._pending: deque[Pending] = deque()
        self._count = 0
        self._ready_ns = 0
        self._changed = asyncio.Event()

    async def may_trigger(self) -> int:
        """Wait for the frame that has to come first; return the earliest time of the next trigger, ns."""
        while self.error is None and self._pending:
            self._changed.clear()
            await self._changed.wait()
        if self.error is not None:
            raise self.error
        return self._ready_ns

    def triggered(self, pending: Pending, sent_ns: int) -> None:
        """A trigger is on its way."""
        pending.index, pending.sent_ns = self._count, sent_ns
        self._count += 1
        self._pending.append(pending)

    def confirmed(self, pending: Pending, confirmed_ns: int) -> None:
        """The camera has it: exposure began before now."""
        pending.end_ns = confirmed_ns + self._times.exposure
        pending.due_ns = pending.end_ns + self._times.readout + self._times.silence
        self._ready_ns = pending.end_ns + self._times.readout
        self._changed.set()

    def refused(self, pending: Pending) -> None:
        """The trigger did not reach the camera: it never was."""
        if self._pending and self._pending[-1] is pending:
            self._pending.pop()
            self._count -= 1
        self._changed.set()

    def arrived(self, arrival: Arrival) -> None:
        """A frame came, whole or not. One that nobody waits for any more has been reported as lost."""
        if not self._pending:
            return
        index = self._pending.popleft().index
        self._changed.set()
        if arrival.payload is None:
            self.channel.put(FrameGap(index, 1, arrival.problem))
            return
        self.channel.put(
            Frame(
                index=index,
                frame_id=arrival.frame_id,
                payload=arrival.payload,
                pixel_format=self._pixel_format,
                shape=self._shape,
                received_ns=arrival.received_ns,
                device_ns=arrival.device_ns,
            )
        )

    async def overdue(self) -> None:
        """Return when a frame should have come long ago."""
        while True:
            self._changed.clear()
            due_ns = self._pending[0].due_ns if self._pending else None
            try:
                async with asyncio.timeout(None if due_ns is None else max(due_ns - now_ns(), 0) * 1e-9):
                    await self._changed.wait()
            except TimeoutError:
                return

    def give_up(self) -> None:
        """The frame does not come. Should it come late, then before the next trigger, which waits as long once more."""
        if self._pending:
            self.channel.put(FrameGap(self._pending.popleft().index, 1, "no frame came within its deadline"))
            self._ready_ns = now_ns() + self._times.silence
            self._changed.set()

    def fail(self, error: DeviceError) -> None:
        """The camera failed: whoever waits gets ``error``. The first error wins."""
        if self.error is None:
            self.error = error
            self.channel.fail(error)
            self._changed.set()

    def finish(self) -> None:
        """Disarmed: report what will not come any more, and end the frames."""
        for pending in self._pending:
            self.channel.put(FrameGap(pending.index, 1, "disarmed before the frame came"))
        self._pending.clear()
        self.channel.close()

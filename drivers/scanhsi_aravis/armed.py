"""What happens between ``arm`` and ``disarm``, on the event loop: arrivals become frames and gaps, deadlines are kept."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from scanhsi.clock import now_ns
from scanhsi.devices.camera import CameraSettings, Trigger
from scanhsi.devices.errors import DeviceError
from scanhsi.devices.frames import Frame, FrameChannel, FrameGap
from scanhsi_aravis.order import ById, ByTrigger, Outcome, Pending
from scanhsi_aravis.ring import Ring
from scanhsi_aravis.stream import Arrival


@dataclass(frozen=True, slots=True)
class Times:
    """Durations of one arming, ns.

    Attributes:
        exposure: Exposure time.
        margin: Added for the upper bound of its end.
        dead: From the end of one exposure to the earliest start of the next.
        silence: A frame is given up, or the camera asked whether it is there, so much later than expected.
    """

    exposure: int
    margin: int
    dead: int
    silence: int


class Armed:
    """State of one arming. Event loop only.

    Args:
        trigger: What starts exposures.
        settings: As applied, with ROI.
        times: Durations.
    """

    def __init__(self, trigger: Trigger, settings: CameraSettings, times: Times) -> None:
        if settings.roi is None:
            raise ValueError("settings as applied have a ROI")
        self.trigger = trigger
        self.channel = FrameChannel()
        self.ring: Ring | None = None
        self.error: DeviceError | None = None
        self._shape = settings.roi.shape
        self._pixel_format = settings.pixel_format
        self._times = times
        self._by_trigger = ByTrigger()
        self._by_id = ById()
        self._resolved = asyncio.Event()
        self._sensor_ready_ns = 0
        self._heard_ns = now_ns()

    # -- arrivals, posted by the receive thread

    def arrived(self, arrival: Arrival) -> None:
        """A buffer came, whole or not."""
        self._heard_ns = now_ns()
        gaps, index = self._place(arrival)
        for gap in gaps:
            self.channel.put(gap)
        if index is not None:
            self.channel.put(self._frame(arrival, index))
        self._resolved.set()

    def _place(self, arrival: Arrival) -> Outcome:
        software = self.trigger is Trigger.SOFTWARE
        if arrival.payload is None:
            return (self._by_trigger if software else self._by_id).lost(arrival.problem), None
        if software:
            return self._by_trigger.arrived(arrival.frame_id, arrival.device_ns)
        return self._by_id.arrived(arrival.frame_id)

    def _frame(self, arrival: Arrival, index: int) -> Frame:
        return Frame(
            index=index,
            frame_id=arrival.frame_id,
            payload=arrival.payload,
            pixel_format=self._pixel_format,
            shape=self._shape,
            received_ns=arrival.received_ns,
            device_ns=arrival.device_ns,
            first_byte_ns=arrival.first_byte_ns,
            exposure_start_ns=None if self.trigger is Trigger.SOFTWARE else self._exposure_start_ns(arrival),
        )

    def _exposure_start_ns(self, arrival: Arrival) -> int | None:
        """The camera's stamp where its clock is ours; else the latest possible: no byte leaves before exposure ends."""
        if arrival.stamped_ns is not None:
            return arrival.stamped_ns
        return None if arrival.first_byte_ns is None else arrival.first_byte_ns - self._times.exposure

    # -- software triggers

    async def may_trigger(self, in_flight: int) -> int:
        """Wait for the frames that have to come first; return the earliest time of the next trigger, ns.

        The first frame of an arming, and the first after a loss, is always waited for: so it is known which one it is.
        """
        pending = self._by_trigger.pending
        while self.error is None and pending and (len(pending) >= in_flight or not self._by_trigger.confirmed):
            self._resolved.clear()
            await self._resolved.wait()
        if self.error is not None:
            raise self.error
        return self._sensor_ready_ns

    def triggered(self, pending: Pending, sent_ns: int) -> None:
        """A trigger is on its way."""
        self._by_trigger.triggered(pending, sent_ns)

    def trigger_confirmed(self, pending: Pending, confirmed_ns: int) -> None:
        """The camera has it: exposure began before now."""
        times = self._times
        pending.end_ns = confirmed_ns + times.exposure + times.margin
        pending.due_ns = pending.end_ns + times.silence
        self._sensor_ready_ns = pending.end_ns + times.dead

    def trigger_refused(self, pending: Pending) -> None:
        """The camera has it not."""
        self._by_trigger.refused(pending)
        self._resolved.set()

    # -- deadlines

    def deadline_ns(self) -> int:
        """When to look whether something is overdue: never later than that."""
        now, silence = now_ns(), self._times.silence
        if self.trigger is not Trigger.SOFTWARE:
            if self.ring is not None:  # while consumers hold every buffer we are deaf, the camera is not silent
                self._heard_ns = max(self._heard_ns, now if self.ring.exhausted else self.ring.heard_again_ns)
            return self._heard_ns + silence
        pending = self._by_trigger.pending
        due = pending[0].due_ns if pending else None
        return now + silence if due is None else due

    def overdue(self) -> bool:
        """Whether the camera has been silent for too long while it could be heard."""
        pending = self._by_trigger.pending
        if self.trigger is Trigger.SOFTWARE and not (pending and pending[0].due_ns is not None):
            return False
        return self.deadline_ns() <= now_ns()

    def forgive(self) -> None:
        """The camera answers: give up the frames that are due and go on."""
        self._heard_ns = now_ns()
        deaf = self.ring is not None and self.ring.exhausted
        reason = "no free buffer: every one is in use" if deaf else "no frame came within its deadline"
        for gap in self._by_trigger.expired(now_ns(), reason):
            self.channel.put(gap)
        self._resolved.set()

    # -- the end

    def fail(self, error: DeviceError) -> None:
        """The camera failed: whoever waits gets ``error``. The first error wins."""
        if self.error is None:
            self.error = error
            self.channel.fail(error)
            self._resolved.set()

    def finish(self) -> None:
        """Disarmed: report what will not come any more, and end the frames."""
        for pending in self._by_trigger.pending:
            self.channel.put(FrameGap(pending.index, 1, "disarmed before the frame came"))
        self._by_trigger.pending.clear()
        self.channel.close()

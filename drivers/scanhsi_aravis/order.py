"""Which exposure a frame belongs to: indices from 0, whatever the camera's own ids do. Plain logic, no hardware.

Both orders turn each arrival into gaps and at most one index, so that every exposure is reported exactly once, in order.
`ById` is for exposures that the camera starts (free run, hardware trigger): ids tell what is missing. `ByTrigger` is for software
triggers, which are counted here: a trigger that the camera ignored leaves no gap in the ids.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from scanhsi.devices.frames import FrameGap

ID_CYCLE = 65535
"""A 16-bit frame id runs 1 ... 65535, 1 ...: 0 is never used (GigE Vision 1.x). 64-bit ids never come round."""

_LAGS = 16
_STAMP_TOLERANCE_NS = 1_000_000

Outcome = tuple[list[FrameGap], int | None]
"""Gaps before the frame, and the frame's index; None when its loss has been reported already."""


def id_distance(previous: int, current: int) -> int:
    """Frames from one id to the next, over the wrap of 16-bit ids; 0 for the same id."""
    if current >= previous:
        return current - previous
    return (current - previous) % ID_CYCLE


class ById:
    """Order of frames that the camera counts."""

    def __init__(self) -> None:
        self._next = 0
        self._last: tuple[int, int] | None = None  # (frame id, index) of the last whole frame

    def lost(self, reason: str) -> list[FrameGap]:
        """An exposure whose frame is not whole."""
        self._next += 1
        return [FrameGap(self._next - 1, 1, reason)]

    def arrived(self, frame_id: int) -> Outcome:
        """A whole frame."""
        index = self._next
        if self._last is not None:
            index = self._last[1] + id_distance(self._last[0], frame_id)
        self._last = frame_id, index
        if index < self._next:
            return [], None
        missing = index - self._next
        gaps = [FrameGap(self._next, missing, "no free buffer, or every packet was lost")] if missing else []
        self._next = index + 1
        return gaps, index


@dataclass(slots=True)
class Pending:
    """A software trigger whose frame has not arrived; loop clock, ns.

    Attributes:
        index: Triggers since arming, from 0; -1 before it is sent.
        sent_ns: When it was sent.
        end_ns: Upper bound of the end of exposure; 0 until the camera has confirmed the trigger.
        due_ns: When its frame is given up; None until the camera has confirmed the trigger.
    """

    index: int = -1
    sent_ns: int = 0
    end_ns: int = 0
    due_ns: int | None = None


class ByTrigger:
    """Order of frames that software triggers started."""

    def __init__(self) -> None:
        self.pending: deque[Pending] = deque()
        self.confirmed = False
        """Whether the last trigger that was resolved made a whole frame."""
        self._count = 0
        self._last_id: int | None = None
        self._reported = 0  # losses since the last whole frame
        self._lags: deque[int] = deque(
            maxlen=_LAGS
        )  # device stamp minus trigger: two clocks, so only differences count

    def triggered(self, pending: Pending, sent_ns: int) -> None:
        """A trigger is being sent."""
        pending.index, pending.sent_ns = self._count, sent_ns
        self._count += 1
        self.pending.append(pending)

    def refused(self, pending: Pending) -> None:
        """The last trigger did not reach the camera: it never was."""
        if self.pending and self.pending[-1] is pending:
            self.pending.pop()
            self._count -= 1

    def lost(self, reason: str) -> list[FrameGap]:
        """The oldest exposure's frame is not whole."""
        if not self.pending:
            return []  # its loss has been reported
        self.confirmed = False
        self._reported += 1
        return [FrameGap(self.pending.popleft().index, 1, reason)]

    def expired(self, now_ns: int, reason: str) -> list[FrameGap]:
        """Give up the frames that are due."""
        gaps: list[FrameGap] = []
        while self.pending and self.pending[0].due_ns is not None and self.pending[0].due_ns <= now_ns:
            gaps += self.lost(reason)
        return gaps

    def arrived(self, frame_id: int, device_ns: int | None) -> Outcome:
        """A whole frame: of the oldest trigger, unless ids or stamps say that its frame is lost."""
        by_id = 0 if self._last_id is None else id_distance(self._last_id, frame_id) - 1 - self._reported
        self._last_id, self._reported = frame_id, 0
        if not self.pending:
            return [], None
        skip = min(max(by_id, self._ignored(device_ns)), len(self.pending) - 1)
        gaps = [
            FrameGap(self.pending.popleft().index, 1, "the camera made no frame of this trigger, or all of it was lost")
            for _ in range(skip)
        ]
        pending = self.pending.popleft()
        if device_ns is not None:
            self._lags.append(device_ns - pending.sent_ns)
        self.confirmed = True
        return gaps, pending.index

    def _ignored(self, device_ns: int | None) -> int:
        """How many of the oldest triggers were ignored: the camera stamped the frame after a later trigger came.

        A camera takes a trigger after it was sent, and takes nearly the same time each time. The shortest such lag of late
        tells the earliest stamp that a trigger can have.
        """
        if device_ns is None or not self._lags:
            return 0
        latest_ns = device_ns - min(self._lags) + _STAMP_TOLERANCE_NS
        return sum(pending.sent_ns <= latest_ns for pending in list(self.pending)[1:])

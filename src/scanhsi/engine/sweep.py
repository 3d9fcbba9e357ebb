"""Continuous scans: which line a frame belongs to, when the camera alone decides when to expose.

The engine does not trigger these exposures, so a pulse that the camera ignored, because it was still busy, leaves no trace in the
frame numbers: every later frame would be stored one line too early. The time stamps tell. A frame that comes three quarters of
a period or more behind its place was preceded by a lost pulse; frames and lost pulses together must make up exactly the lines of
the sweep, or the scan fails rather than put pixels in the wrong place.
"""

from __future__ import annotations

import asyncio

from scanhsi.clock import now_ns
from scanhsi.devices import Frame, FrameEvent, FrameGap, FrameStream, Sweep, Trigger
from scanhsi.devices.errors import DeviceTimeout, ProtocolError
from scanhsi.engine.receive import hand_on, past, take
from scanhsi.engine.scan import Scan

LATE = 0.75
"""Part of a period by which a frame must be late to prove that a pulse was lost."""


class Places:
    """Gives each exposure its line.

    Args:
        period_s: Of the lines.
        trigger: LINE counts pulses; FREE_RUN counts the camera's own beats from the moment the mirror passes the first line.
        passing_ns: When the mirror passes the first line, as announced.
    """

    def __init__(self, period_s: float, trigger: Trigger, passing_ns: int) -> None:
        self._period_ns = period_s * 1e9
        self._trigger = trigger
        self._passing_ns = passing_ns
        self._origin: tuple[int, int] | None = None
        self._shift = 0

    def line_of(self, frame: Frame) -> int:
        """Line of a frame; negative for one exposed before the mirror passed the first line."""
        if self._origin is None:
            return self._first(frame)
        line = frame.index + self._shift
        if frame.device_ns is not None and self._trigger is Trigger.LINE:
            first_line, first_ns = self._origin
            late = first_line + (frame.device_ns - first_ns) / self._period_ns - line
            if late > LATE:
                self._shift += round(late)
                line += round(late)
        return line

    @property
    def shifted(self) -> bool:
        """Whether a pulse was taken for lost."""
        return self._shift > 0 and self._trigger is Trigger.LINE

    def line_of_exposure(self, index: int) -> int:
        """Line of an exposure whose frame is lost."""
        return index + self._shift

    def _first(self, frame: Frame) -> int:
        """The first frame anchors the rest."""
        line = frame.index
        if frame.exposure_start_ns is not None:
            late = (frame.exposure_start_ns - self._passing_ns) / self._period_ns - frame.index
            if self._trigger is Trigger.FREE_RUN or late > LATE:
                self._shift = round(late)
            line += self._shift
        if frame.device_ns is not None:
            self._origin = (line, frame.device_ns)
        return line


async def receive_sweep(scan: Scan, sweep: Sweep, places: Places) -> None:
    """Take the frames of a sweep until each line has one or is known to be lost."""
    stream = scan.camera.frames()
    line = 0
    while line < sweep.count:
        event = await _next(scan, stream, line)
        if event is None:
            if not scan.stop.is_set():
                _give_up(scan, line, sweep.count)
            break
        if isinstance(event, FrameGap):
            until = min(places.line_of_exposure(past(event)), sweep.count)
            line = _lose(scan, range(line, until), event.reason)
            continue
        place = places.line_of(event)
        if place < line:
            continue
        line = _lose(scan, range(line, min(place, sweep.count)), "the camera was still busy when this line was due")
        if place < sweep.count:
            line = await _take_or_drop(scan, event, line, sweep)
    if places.shifted:
        await _refuse_surplus(scan, stream)
    scan.filled.put_nowait(None)


async def _take_or_drop(scan: Scan, frame: Frame, line: int, sweep: Sweep) -> int:
    if not scan.credits.may_store(line):
        return _lose(scan, range(line, line + 1), "no free line buffer: storage was too slow for this sweep")
    if not line:
        scan.begun_ns = frame.exposure_start_ns or frame.received_ns
    records = scan.records
    records.mirror_step[line] = sweep.first + line * sweep.every
    if frame.exposure_start_ns is not None:
        records.stamps["exposure_start"][line] = frame.exposure_start_ns
        exposure_ns = round(scan.course.settings.exposure_s * 1e9)
        records.stamps["exposure_end"][line] = frame.exposure_start_ns + exposure_ns
    await take(scan, frame, line)
    hand_on(scan, line)
    return line + 1


def _lose(scan: Scan, lines: range, reason: str) -> int:
    for line in lines:
        scan.records.mark_missing(line, reason)
        hand_on(scan, line)
    return lines.stop if len(lines) else lines.start


def _give_up(scan: Scan, line: int, count: int) -> None:
    """The camera is silent. Behind the end of the sweep that costs the rest of the lines, before it the scan."""
    if not (scan.motion_over.is_set() and line):
        raise DeviceTimeout(
            "no frame came although the mirror is sweeping.",
            device=scan.camera.info.name,
            operation="receive",
            line=line,
            waited_s=scan.deadlines.frame_s,
            hint="check the trigger cable and the camera's trigger line; then power and network.",
        )
    _lose(scan, range(line, count), "no frame came for the trigger of this line")


async def _next(scan: Scan, stream: FrameStream, line: int) -> FrameEvent | None:
    """The next event; None when the camera is silent beyond its deadline, or disarmed because a stop was asked for."""
    try:
        async with asyncio.timeout(scan.deadlines.frame_s + (0.0 if line else scan.deadlines.first_move_s)):
            return await anext(stream, None)
    except TimeoutError:
        return None


async def _refuse_surplus(scan: Scan, stream: FrameStream) -> None:
    """A frame more than there are lines proves that a pulse was taken for lost that was not."""
    await scan.motion_over.wait()
    try:
        async with asyncio.timeout(scan.settling_s):
            surplus = await anext(stream, None)
    except TimeoutError:
        return
    if isinstance(surplus, Frame):
        raise ProtocolError(
            "there are more frames than lines: some came so late that they were taken for a later line.",
            device=scan.camera.info.name,
            hint="scan with a longer period.",
        )


def passing_ns(run_up_s: float) -> int:
    """When a sweep that is commanded now passes its first line."""
    return now_ns() + round(run_up_s * 1e9)

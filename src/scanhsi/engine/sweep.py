"""Continuous scans: which line a frame belongs to, when the camera alone decides when to expose.

The engine does not trigger these exposures, so a pulse that the camera ignored, because it was still busy, leaves no trace in the
frame numbers: every later frame would be stored one line too early. The camera's time stamps raise the doubt: a frame that comes
three quarters of a period or more after its due time. Then the actuator is asked where the mirror is, which settles it. Where that
is past its end already, the exposures are counted: if they are as many as the pulses, none was ignored. In the end frames and lost
pulses must make up exactly the lines of the sweep, or the scan fails rather than put pixels in the wrong place.

A camera that runs free keeps a beat that knows nothing of the mirror, which begins when it begins and keeps its own time. So there
the actuator is asked again and again where the mirror is, and a frame gets the line nearest to where its exposure began.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Awaitable, Callable

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices import Frame, FrameEvent, FrameGap, Sighting, Sweep, Trigger
from scanhsi.devices.errors import DeviceTimeout, FrameLost, ProtocolError
from scanhsi.engine.control import as_sweeping
from scanhsi.engine.deadlines import Part
from scanhsi.engine.plan import OnFault
from scanhsi.engine.receive import hand_on, listen, past, take
from scanhsi.engine.scan import Scan

LATE = 0.75
"""Part of a period by which a frame must be late to raise the doubt that a pulse was lost."""
_SIGHTINGS = 6
_LOOK_EVERY_NS = 15_000_000
"""How often the actuator is asked beside a camera that runs free; where a line takes longer, with each frame."""
_GUARD = 0.15
"""A sighting this close to a line, in periods, could be on either side of it: look again."""


class Events:
    """The events of a leg's camera in order; those to come can be looked at before they are taken."""

    def __init__(self, scan: Scan) -> None:
        self._scan = scan
        self._stream = scan.camera.frames()
        self._ahead: deque[FrameEvent] = deque()

    async def next(self) -> FrameEvent | None:
        """The next event; None when there are no more."""
        return self._ahead.popleft() if self._ahead else await self._hear()

    async def reach(self, count: int, taken: int) -> bool:
        """Whether there are ``count`` exposures in all, when those before ``taken`` are known: waits until the mirror stands."""
        reached = max([taken, *map(past, self._ahead)])
        if reached < count:
            await self._scan.leg.motion_over.wait()
        with contextlib.suppress(TimeoutError):
            while reached < count:
                event = await listen(self._hear, self._scan.settling_s)
                if event is None:
                    break
                self._ahead.append(event)
                reached = max(reached, past(event))
        return reached >= count

    async def _hear(self) -> FrameEvent | None:
        try:
            return await anext(self._stream, None)
        except Exception as error:
            self._scan.watch.blame(Part.CAMERA, error)
            raise


class Places:
    """Gives each exposure its line.

    Args:
        sweep: As it runs.
        first: Its first line.
        trigger: LINE counts pulses; FREE_RUN counts the camera's own beats from the moment the mirror passes the first line.
        passing_ns: When the mirror passes the first line at the earliest, as announced.
        locate: Asks the actuator where the mirror is: in doubt, or with a camera that runs free.
        reach: Tells whether there are so many exposures in all, when those before another number are known.
    """

    def __init__(
        self,
        sweep: Sweep,
        first: int,
        trigger: Trigger,
        passing_ns: int,
        locate: Callable[[], Awaitable[Sighting]],
        reach: Callable[[int, int], Awaitable[bool]],
    ) -> None:
        self._sweep = sweep
        self._first = first
        self._period_ns = sweep.period_s * 1e9
        self._trigger = trigger
        self._passing_ns = passing_ns
        self._locate = locate
        self._reach = reach
        self._previous: Frame | None = None
        self._shift = 0
        self._look_ns = passing_ns

    @property
    def skipped(self) -> str:
        """Why a line has no frame although the next ones have."""
        if self._trigger is Trigger.FREE_RUN:
            return "the mirror was past this line before the camera began its next exposure"
        return "the camera was still busy when this line was due"

    @property
    def shifted(self) -> bool:
        """Whether a pulse was taken for lost."""
        return self._shift > 0 and self._trigger is Trigger.LINE

    def line_of_exposure(self, index: int) -> int:
        """Line of an exposure whose frame is lost; the first as long as a free-running camera has given no frame to count from."""
        unknown = self._trigger is Trigger.FREE_RUN and self._previous is None
        return self._first + (0 if unknown else index + self._shift)

    async def line_of(self, frame: Frame) -> int:
        """Line of a frame; less than the first for one exposed before the mirror passed that."""
        if self._trigger is Trigger.FREE_RUN:
            return self._first + await self._nearest(frame)
        if self._stale(frame):  # its stamp tells nothing: the next one is compared with the last that did
            seen = await self._seen(frame)
            self._shift = max(self._shift, self._shift if seen is None else seen - frame.index)
            return self._first + frame.index + self._shift
        if (late := self._late(frame)) > LATE:
            seen = await self._seen(frame)
            self._shift = max(self._shift, round(late) + self._shift if seen is None else seen - frame.index)
        self._previous = frame
        return self._first + frame.index + self._shift

    async def _nearest(self, frame: Frame) -> int:
        """Line of the sweep that the mirror was nearest to when the exposure began; less than 0 before it passed the first."""
        place = frame.index + self._shift
        if self._previous is None:
            place += round(self._late(frame))  # no mirror is there before it was announced
            if place < 0:
                return place
        if (asked_ns := now_ns()) >= self._look_ns or self._previous is None:
            self._look_ns = asked_ns + _LOOK_EVERY_NS
            seen = await self._seen_between(frame)
            if seen is not None and (self._previous is None or abs(seen - place) > 0.5 + 0.5 / abs(self._sweep.every)):
                place = round(seen)
            if seen is not None and place < 0:
                return place  # it has still not passed: the next frame is asked for, too
        self._shift, self._previous = place - frame.index, frame
        return place

    async def _seen_between(self, frame: Frame) -> float | None:
        """Where between lines the mirror was as the exposure began, by where it is now; None when that cannot be told."""
        if frame.exposure_start_ns is None:
            return None
        for _ in range(_SIGHTINGS):
            seen = await self._locate()
            passed = (seen.step - self._sweep.first) / self._sweep.every + 0.5 / abs(self._sweep.every)
            if passed >= self._sweep.count:
                return None  # it may stand by now
            if seen.uncertain_ns < LATE / 2 * self._period_ns:
                return passed - (seen.at_ns - frame.exposure_start_ns) / self._period_ns
        return None

    def _stale(self, frame: Frame) -> bool:
        """Whether a camera that lost the frame's leader gave it the stamp of an earlier one."""
        previous = self._previous
        stamps = frame.device_ns, previous.device_ns if previous is not None else None
        return stamps[0] is not None and stamps[1] is not None and stamps[0] <= stamps[1]

    def _late(self, frame: Frame) -> float:
        """How late a frame is, in periods: by the camera's clock after its predecessor, the first by the announced passing."""
        previous = self._previous
        if previous is None:
            start_ns = self._passing_ns if frame.exposure_start_ns is None else frame.exposure_start_ns
            return (start_ns - self._passing_ns) / self._period_ns - frame.index
        if frame.device_ns is None or previous.device_ns is None:
            return 0.0
        return (frame.device_ns - previous.device_ns) / self._period_ns - (frame.index - previous.index)

    async def _seen(self, frame: Frame) -> int | None:
        """Line of the sweep, by where the mirror is now and the time since the exposure began; None when that cannot be told."""
        if frame.exposure_start_ns is None:
            return None
        for _ in range(_SIGHTINGS):
            seen = await self._locate()
            passed = math.floor((seen.step - self._sweep.first) / self._sweep.every)
            if passed >= self._sweep.count:
                none_lost = await self._reach(self._sweep.count - self._shift, past(frame))
                return frame.index + self._shift if none_lost else None
            periods = (seen.at_ns - frame.exposure_start_ns) / self._period_ns
            guard = _GUARD + seen.uncertain_ns / self._period_ns
            if guard < periods % 1 < 1 - guard:
                return passed - math.floor(periods)
            await sleep_until_ns(seen.at_ns + round((1 + (0.5 - periods) % 1) * self._period_ns))
        return None


async def receive_sweep(scan: Scan, sweep: Sweep, events: Events, places: Places) -> None:
    """Take the frames of a sweep until each line has one or is known to be lost."""
    line, end = scan.leg.first, scan.course.lines
    behind_gap = False
    while line < end:
        event = await _next(scan, events, sweep, line)
        if event is None:
            if not scan.leg.cut:
                _give_up(scan, sweep, line)
            break
        if isinstance(event, FrameGap):
            until = min(places.line_of_exposure(past(event)), end)
            line, behind_gap = _lose(scan, range(line, until), event.reason), True
            continue
        place = await places.line_of(event)
        if place < line:
            continue
        behind_gap |= place > line
        line = _lose(scan, range(line, min(place, end)), places.skipped)
        if place < end:
            if behind_gap:
                await _catch_up(scan, line, sweep)
                behind_gap = False
            line = await _take_or_drop(scan, event, line)
    if places.shifted:
        await _refuse_surplus(scan, events)


async def _take_or_drop(scan: Scan, frame: Frame, line: int) -> int:
    if not scan.credits.may_store(line):
        return _lose(scan, range(line, line + 1), "no free line buffer: storage was too slow for this sweep")
    if line == scan.first and frame.exposure_start_ns is not None:
        scan.begun_ns = frame.exposure_start_ns
    records = scan.records
    records.attempt[line] = scan.faults.tries[line] + 1
    records.mirror_step[line] = scan.course.steps[line]
    if frame.exposure_start_ns is not None:
        records.stamps["exposure_start"][line] = frame.exposure_start_ns
        exposure_ns = round(scan.course.settings.exposure_s * 1e9)
        records.stamps["exposure_end"][line] = frame.exposure_start_ns + exposure_ns
    await take(scan, frame, line)
    hand_on(scan, line)
    return line + 1


async def _catch_up(scan: Scan, line: int, sweep: Sweep) -> None:
    """Lines of a gap come to storage all at once, with the frame behind it: give it until the next frame to take them."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(sweep.period_s):
            await scan.credits.wait(line)


def _lose(scan: Scan, lines: range, reason: str) -> int:
    if len(lines) and scan.faults.recovery.on_fault is OnFault.ABORT:
        raise FrameLost(f"{reason}.", device=scan.camera_info.name, operation="receive", line=lines.start)
    for line in lines:
        scan.records.mark_missing(line, reason)
        hand_on(scan, line)
    return lines.stop if len(lines) else lines.start


def _give_up(scan: Scan, sweep: Sweep, line: int) -> None:
    """The camera is silent. Behind the end of the sweep that costs the rest of the lines, before it the scan."""
    if not (scan.leg.motion_over.is_set() and line > scan.leg.first):
        raise DeviceTimeout(
            f"no frame came although the mirror is sweeping; {scan.watch.last_heard(Part.CAMERA)}.",
            device=scan.camera_info.name,
            operation="receive",
            line=line,
            waited_s=_patience_s(scan, sweep, line),
            hint="check the trigger cable and the camera's trigger line; then power and network.",
        )
    _lose(scan, range(line, scan.course.lines), "no frame came for the trigger of this line")


async def _next(scan: Scan, events: Events, sweep: Sweep, line: int) -> FrameEvent | None:
    """The next event; None when the camera is silent beyond its deadline, or disarmed because a stop was asked for."""
    try:
        event = await listen(events.next, _patience_s(scan, sweep, line))
    except TimeoutError:
        return None
    scan.watch.heard(Part.CAMERA, "frame", line)
    return event


def _patience_s(scan: Scan, sweep: Sweep, line: int) -> float:
    """How long a frame may take after its predecessor; the first waits for the run-up, too."""
    first_s = (
        0.0 if line > scan.leg.first else scan.deadlines.first_move_s + 2 * as_sweeping(scan.actuator).run_up_s(sweep)
    )
    return first_s + 2 * sweep.period_s + scan.deadlines.frame_s


async def _refuse_surplus(scan: Scan, events: Events) -> None:
    """A frame more than there are lines proves that a pulse was taken for lost that was not."""
    await scan.leg.motion_over.wait()
    try:
        async with asyncio.timeout(scan.settling_s):
            surplus = await events.next()
    except TimeoutError:
        return
    if isinstance(surplus, Frame):
        error = ProtocolError(
            "there are more frames than lines: some came so late that they were taken for a later line.",
            device=scan.camera_info.name,
            hint="scan with a longer period.",
        )
        raise scan.faults.beyond_repair(error)


def passing_ns(run_up_s: float) -> int:
    """When a sweep that is commanded now passes its first line."""
    return now_ns() + round(run_up_s * 1e9)

"""Receive: put frames into order, unpack them into line buffers, mark what is lost. And write: hand the lines over to storage."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from scanhsi.clock import now_ns
from scanhsi.devices import Frame, FrameEvent, FrameGap
from scanhsi.devices.errors import DeviceLost, FrameLost, ProtocolError
from scanhsi.engine.deadlines import Part
from scanhsi.engine.plan import OnFault
from scanhsi.engine.scan import FLUSH, Scan

Event = TypeVar("Event")

SILENT_LINES = 2
"""So many lines in a row without their frame and without a word from the camera: it is gone."""


async def receive_exposed(scan: Scan) -> None:
    """Step modes: one event of the camera for each exposure, in order, each within its deadline."""
    events = _Events(scan)
    faults = scan.faults
    while (line := await scan.leg.exposed.get()) is not None:
        event = await events.next(line)
        faults.silent = faults.silent + 1 if event is None else 0
        if isinstance(event, Frame):
            await take(scan, event, line)
        elif isinstance(event, FrameGap):
            _lost(scan, line, event.reason)
        elif faults.silent < SILENT_LINES:
            _lost(scan, line, f"its frame did not arrive within {scan.deadlines.frame_s:g} s")
        else:
            raise _gone(scan, line)
        hand_on(scan, line)


def _lost(scan: Scan, line: int, reason: str) -> None:
    """A frame will not come: as the plan has it, the line is missing, or an error says that it is to be taken again, or the end.

    Raises:
        FrameLost: The line is not given up.
    """
    faults = scan.faults
    if faults.recovery.on_fault is OnFault.ABORT or faults.may_try_again(line):
        raise FrameLost(f"{reason}.", device=scan.camera_info.name, operation="receive", line=line)
    tries = faults.tries[line]
    scan.records.mark_missing(line, f"{reason} (tried {tries + 1} times)" if tries else reason)


class _Events:
    """The camera's events, asked for line by line. Lines come in order, and so do events."""

    def __init__(self, scan: Scan) -> None:
        self._scan = scan
        self._first = scan.leg.first
        self._stream = scan.camera.frames()
        self._held: FrameEvent | None = None

    async def next(self, line: int) -> FrameEvent | None:
        """The frame of ``line``, the gap it fell into, or None when the deadline has passed without a word.

        What comes too late for a line that is given up already is let go; what belongs to a later line is kept for it.
        """
        exposure = line - self._first
        if self._held is None or past(self._held) <= exposure:
            self._held = await self._receive(line, exposure)
        event = self._held
        if event is not None and (event.first if isinstance(event, FrameGap) else event.index) > exposure:
            return FrameGap(exposure, 1, "its frame was lost without a word: the next one came")
        return event

    async def _receive(self, line: int, exposure: int) -> FrameEvent | None:
        try:
            event = await listen(lambda: self._behind(exposure), self._scan.deadlines.frame_s)
        except TimeoutError:
            return None
        except Exception as error:
            self._scan.watch.blame(Part.CAMERA, error)
            raise
        if event is None:
            device = self._scan.camera_info.name
            raise ProtocolError("the frames ended before the last line.", device=device, line=line)
        self._scan.watch.heard(Part.CAMERA, "frame", line)
        return event

    async def _behind(self, exposure: int) -> FrameEvent | None:
        """The next event that is not of an earlier exposure only."""
        while (event := await anext(self._stream, None)) is not None and past(event) <= exposure:
            pass
        return event


async def listen(hear: Callable[[], Awaitable[Event]], limit_s: float) -> Event:
    """What ``hear`` gives within ``limit_s``.

    A loop that was held up beyond that limit was deaf meanwhile, so the silence may be its own: it listens as long again as it
    was late.

    Raises:
        TimeoutError: Nothing was heard.
    """
    loop = asyncio.get_running_loop()
    due = loop.time() + limit_s
    timer = asyncio.timeout_at(due)
    try:
        async with timer:
            return await hear()
    except TimeoutError:
        if not timer.expired():  # it is what was heard
            raise
        deaf_s = loop.time() - due
    async with asyncio.timeout(deaf_s):
        return await hear()


def past(event: FrameEvent) -> int:
    """First exposure behind an event."""
    return event.first + event.count if isinstance(event, FrameGap) else event.index + 1


def _gone(scan: Scan, line: int) -> DeviceLost:
    return DeviceLost(
        f"no frame came for {SILENT_LINES} lines in a row; {scan.watch.last_heard(Part.CAMERA)}.",
        device=scan.camera_info.name,
        operation="receive",
        line=line,
        waited_s=scan.deadlines.frame_s,
        hint="check power and cable of the camera, then start again.",
    )


async def take(scan: Scan, frame: Frame, line: int) -> None:
    """Unpack a frame into the buffer of its line and record what is known of it."""
    records = scan.records
    stamps = records.stamps
    stamps["received"][line] = frame.received_ns
    if frame.first_byte_ns is not None:
        stamps["first_byte"][line] = frame.first_byte_ns
    if frame.device_ns is not None:
        records.device_ns[line] = frame.device_ns
    records.frame_id[line] = frame.frame_id
    async with scan.watch(Part.CAMERA, scan.deadlines.frame_s, "unpack", line=line):
        await scan.camera.unpack(frame, scan.sink.buffer(line))
    stamps["copied"][line] = now_ns()


def hand_on(scan: Scan, line: int) -> None:
    """A line is received, or given up: on to storage."""
    scan.taken = line + 1
    scan.credits.unpacked(line)
    scan.filled.put_nowait(line)
    scan.tell()


async def write_lines(scan: Scan) -> None:
    """Hand lines to the sink in order; whatever it names safe frees its buffer."""
    while (line := await scan.filled.get()) is not None:
        if line == FLUSH:
            await _flush(scan)
            continue
        async with scan.watch(Part.STORAGE, scan.deadlines.store_s, "store", line=line):
            safe = await scan.sink.append(line)
        scan.credits.safe(safe)
        scan.credits.handed_over(line)
    await _flush(scan)


async def _flush(scan: Scan) -> None:
    async with scan.watch(Part.STORAGE, scan.deadlines.store_s, "store"):
        scan.credits.safe(await scan.sink.flush())

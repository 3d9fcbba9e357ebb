"""Receive: put frames into order, unpack them into line buffers, mark what is lost. And write: hand the lines over to storage."""

from __future__ import annotations

import asyncio

from scanhsi.clock import now_ns
from scanhsi.devices import Frame, FrameEvent, FrameGap, FrameStream
from scanhsi.devices.errors import DeviceLost, ProtocolError
from scanhsi.engine.deadlines import Deadline
from scanhsi.engine.scan import Scan

SILENT_LINES = 2
"""So many lines in a row without their frame and without a word from the camera: it is gone."""


async def receive_exposed(scan: Scan) -> None:
    """Step modes: one event of the camera for each exposure, in order, each within its deadline."""
    stream = scan.camera.frames()
    lost = range(0)
    silent = 0
    while (line := await scan.exposed.get()) is not None:
        if line not in lost:
            event = await _next(scan, stream, line)
            silent = silent + 1 if event is None else 0
            lost = await _settle(scan, line, event, silent)
        hand_on(scan, line)
    scan.filled.put_nowait(None)


async def _next(scan: Scan, stream: FrameStream, line: int) -> FrameEvent | None:
    """The camera's next word about ``line`` or a later one; None when the deadline has passed without any.

    What comes too late for a line that is given up already is let go.
    """
    try:
        async with asyncio.timeout(scan.deadlines.frame_s):
            while True:
                event = await anext(stream, None)
                if event is None:
                    device = scan.camera.info.name
                    raise ProtocolError("the frames ended before the last line.", device=device, line=line)
                if past(event) > line:
                    return event
    except TimeoutError:
        return None


def past(event: FrameEvent) -> int:
    """First exposure behind an event."""
    return event.first + event.count if isinstance(event, FrameGap) else event.index + 1


async def _settle(scan: Scan, line: int, event: FrameEvent | None, silent: int) -> range:
    """Take the frame of ``line`` or mark it missing; return the lines that the event tells to be lost."""
    if isinstance(event, FrameGap):
        lost = range(event.first, past(event))
        for gone in lost:
            scan.records.mark_missing(gone, event.reason)
        _check_order(scan, max(event.first, line), line)
        return lost
    if event is not None:
        _check_order(scan, event.index, line)
        await take(scan, event, line)
    elif silent < SILENT_LINES:
        scan.records.mark_missing(line, f"its frame did not arrive within {scan.deadlines.frame_s:g} s")
    else:
        raise DeviceLost(
            f"no frame came for {SILENT_LINES} lines in a row.",
            device=scan.camera.info.name,
            operation="receive",
            line=line,
            waited_s=scan.deadlines.frame_s,
            hint="check power and cable of the camera, then start again.",
        )
    return range(0)


def _check_order(scan: Scan, index: int, line: int) -> None:
    if index != line:
        device = scan.camera.info.name
        raise ProtocolError(f"the camera delivered exposure {index} where {line} was due.", device=device, line=line)


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
    async with Deadline(scan.deadlines.frame_s, "unpack", device=scan.camera.info.name, line=line):
        await scan.camera.unpack(frame, scan.sink.buffer(line))
    stamps["copied"][line] = now_ns()


def hand_on(scan: Scan, line: int) -> None:
    """A line is received, or given up: on to storage."""
    scan.taken = line + 1
    scan.filled.put_nowait(line)
    scan.tell()


async def write_lines(scan: Scan) -> None:
    """Hand lines to the sink in order; whatever it names safe frees its buffer."""
    while (line := await scan.filled.get()) is not None:
        async with Deadline(scan.deadlines.store_s, "store", device="storage", line=line):
            safe = await scan.sink.append(line)
        scan.credits.advance(safe)
        scan.handed_over.release()
    async with Deadline(scan.deadlines.store_s, "store", device="storage"):
        scan.credits.advance(await scan.sink.flush())

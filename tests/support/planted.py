"""Bugs planted on purpose, one at a time: whoever claims to find bugs shall find these.

Each is a context manager's worth of monkeypatching: what an engineer in a hurry could have written. `PLANTED` names them all.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from scanhsi.cube.layout import STATUS
from scanhsi.cube.records import LineRecords
from scanhsi.cube.shards import CubeFiles
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices import Frame, FrameGap
from scanhsi.engine import Mode, control, legs, receive, recovery, run, safety, sweep
from scanhsi.engine.deadlines import Part
from scanhsi.engine.scan import Credits, Scan

Patch = tuple[Any, str, Any]


def _moves_before_the_exposure_ends() -> list[Patch]:
    original = control._expose

    async def expose(scan: Scan, line: int, foretold: Any = None) -> None:
        ahead = None
        if scan.course.mode is Mode.STEPPED and foretold is None and line + 1 < scan.course.lines:
            ahead = asyncio.ensure_future(_move_early(scan, line + 1))
        try:
            await original(scan, line, foretold)
            if ahead is not None:
                await ahead
        finally:
            if ahead is not None:
                ahead.cancel()

    async def _move_early(scan: Scan, line: int) -> None:
        await asyncio.sleep(0.9 * scan.course.settings.exposure_s)
        await scan.actuator.move_to(int(scan.course.steps[line]))

    return [(control, "_expose", expose)]


def _status_before_data() -> list[Patch]:
    original = CubeFiles.write_pixels

    def write_pixels(self: CubeFiles, pixels: Any) -> Any:
        chunk = np.zeros(self._layout.lines_per_shard, np.dtype(STATUS.dtype))
        chunk[: len(pixels.lost)] = 1 + pixels.lost
        shard = pixels.first // self._layout.lines_per_shard
        self.destination.put(f"status/c/{shard}", [memoryview(chunk.tobytes())], durable=self._durable)
        return original(self, pixels)

    return [(CubeFiles, "write_pixels", write_pixels)]


def _records_after_the_status() -> list[Patch]:
    columns, status = CubeFiles.write_columns, CubeFiles.write_status

    def write_status(self: CubeFiles, records: Any) -> None:
        status(self, records)
        columns(self, records)

    return [(CubeFiles, "write_columns", lambda self, records: None), (CubeFiles, "write_status", write_status)]


def _no_credits() -> list[Patch]:
    return [(Credits, "may_expose", lambda self, line: True)]


def _credit_leak() -> list[Patch]:
    original = Credits.safe

    def safe(self: Credits, lines: range) -> None:
        original(self, range(lines.start, lines.stop - (1 if lines.stop > 5 else 0)))

    return [(Credits, "safe", safe)]


def _retakes_at_the_wrong_line() -> list[Patch]:
    async def approach(scan: Scan) -> bool:
        line = max(scan.leg.first - (len(scan.leg_starts) > 1), 0)
        await scan.actuator.move_to(int(scan.course.steps[line]))
        return True

    return [(legs, "approach", approach)]


def _swallows_gaps() -> list[Patch]:
    class Swallowing(receive._Events):
        async def _receive(self, line: int, exposure: int) -> Any:
            event = await super()._receive(line, exposure)
            return await super()._receive(line, exposure) if isinstance(event, FrameGap) else event

    return [(receive, "_Events", Swallowing)]


def _stores_twice() -> list[Patch]:
    """A line that was tried again is handed on twice, in the place of the next one."""
    original = receive.take

    async def take(scan: Scan, frame: Frame, line: int) -> None:
        await original(scan, frame, line)
        if scan.records.attempt[line] > 1 and line + 1 < scan.course.lines:
            receive.hand_on(scan, line)
            for name in ("exposure_start", "trigger"):
                scan.records.stamps[name][line + 1] = scan.records.stamps[name][line]

    return [(receive, "take", take)]


def _forgets_to_disarm() -> list[Patch]:
    original = safety.make_safe

    def make_safe(scan: Scan) -> list[Any]:
        steps = original(scan)
        return steps[:1] if scan.taken else steps

    return [(safety, "make_safe", make_safe)]


def _forgets_to_stop() -> list[Patch]:
    original = safety.make_safe
    return [(safety, "make_safe", lambda scan: original(scan)[1:])]


def _off_by_one_after_a_duplicate() -> list[Patch]:
    class OneOff(receive._Events):
        _seen = -1

        async def _receive(self, line: int, exposure: int) -> Any:
            try:
                async with asyncio.timeout(self._scan.deadlines.frame_s):
                    event = await anext(self._stream, None)
            except TimeoutError:
                return None
            if isinstance(event, Frame) and event.index == self._seen:
                event.index = exposure
            elif isinstance(event, Frame):
                self._seen = event.index
            return event

    return [(receive, "_Events", OneOff)]


def _no_deadlines() -> list[Patch]:
    original = run.deadlines

    def deadlines(*args: Any, **keywords: Any) -> Any:
        found = original(*args, **keywords)
        return replace(found, frame_s=1e6, expose_s=1e6, move_s=1e6)

    return [(run, "deadlines", deadlines)]


def _flush_is_not_awaited() -> list[Patch]:
    async def drain(self: CubeWriter) -> None:
        await asyncio.sleep(0)

    return [(CubeWriter, "_drain", drain)]


def _uses_a_buffer_that_is_being_written() -> list[Patch]:
    doubled = property(lambda self: 2 * self._slots * self._layout.lines_per_shard)
    return [(CubeWriter, "capacity", doubled), (CubeWriter, "_slot_is_free", lambda self, line: True)]


def _smeared_lines_are_not_flagged() -> list[Patch]:
    original = control._expose_and_move_on

    async def expose_and_move_on(scan: Scan, line: int) -> None:
        await original(scan, line)
        scan.records.smeared[line] = 0

    return [(control, "_expose_and_move_on", expose_and_move_on)]


def _swallows_a_cancellation() -> list[Patch]:
    original = legs.finish

    async def finish(work: Any) -> tuple[list[BaseException], bool]:
        failures, _ = await original(work)
        return failures, False

    return [(legs, "finish", finish), (run, "finish", finish)]


def _reasons_are_made_up() -> list[Patch]:
    def mark_missing(self: LineRecords, line: int, reason: str) -> None:
        del reason
        self.missing.setdefault(line, "lost")

    return [(LineRecords, "mark_missing", mark_missing)]


def _lets_device_errors_out() -> list[Patch]:
    def raises(causes: Any, **_: Any) -> BaseException:
        return causes[0]

    return [(run, "ScanFailed", raises)]


def _metadata_of_the_line_before() -> list[Patch]:
    original = receive.take

    async def take(scan: Scan, frame: Frame, line: int) -> None:
        await original(scan, frame, line)
        if scan.records.attempt[line] > 1 and line:
            scan.records.frame_id[line] = scan.records.frame_id[line - 1]

    return [(receive, "take", take)]


def _trusts_the_position_after_a_reset() -> list[Patch]:
    async def knows(scan: Scan) -> bool:
        return scan.leg.first > 0

    return [(legs, "_knows_its_position", knows)]


def _goes_on_without_the_lost_device() -> list[Patch]:
    async def bring_back(scan: Scan, part: Part, until_ns: int) -> None:
        return None

    return [(recovery, "_bring_back", bring_back)]


def _a_lost_pulse_shifts_the_lines() -> list[Patch]:
    async def line_of(self: Any, frame: Frame) -> int:
        return frame.index + self._shift - (frame.index > 4)

    return [(sweep.Places, "line_of", line_of)]


PLANTED: dict[str, Callable[[], list[Patch]]] = {
    bug.__name__.strip("_").replace("_", " "): bug
    for bug in (
        _moves_before_the_exposure_ends,
        _status_before_data,
        _records_after_the_status,
        _no_credits,
        _credit_leak,
        _retakes_at_the_wrong_line,
        _swallows_gaps,
        _stores_twice,
        _forgets_to_disarm,
        _forgets_to_stop,
        _off_by_one_after_a_duplicate,
        _no_deadlines,
        _flush_is_not_awaited,
        _uses_a_buffer_that_is_being_written,
        _smeared_lines_are_not_flagged,
        _swallows_a_cancellation,
        _reasons_are_made_up,
        _lets_device_errors_out,
        _metadata_of_the_line_before,
        _trusts_the_position_after_a_reset,
        _goes_on_without_the_lost_device,
        _a_lost_pulse_shifts_the_lines,
    )
}


@contextmanager
def planted(name: str) -> Generator[None]:
    """The program with one bug, while entered."""
    patches = PLANTED[name]()
    modules = (control, legs, receive, recovery, run, safety, sweep)
    undo: list[Patch] = []
    for where, attribute, value in patches:
        original = where.__dict__[attribute] if isinstance(where, type) else getattr(where, attribute)
        undo.append((where, attribute, original))
        setattr(where, attribute, value)
        for module in modules if not isinstance(where, type) else ():  # those that imported the name
            if getattr(module, attribute, None) is original:
                undo.append((module, attribute, original))
                setattr(module, attribute, value)
    try:
        yield
    finally:
        for where, attribute, value in reversed(undo):
            setattr(where, attribute, value)

"""The state that the tasks of one scan share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from scanhsi.clock import now_ns
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.devices import Actuator, Camera
from scanhsi.engine.deadlines import Deadlines
from scanhsi.engine.lookahead import Latencies
from scanhsi.engine.plan import Course
from scanhsi.engine.report import Progress

CAMERA_BUFFERS = 16
"""Frame buffers of the camera: a third of a second of stalled unpacking at full rate."""
PROGRESS_INTERVAL_NS = 250_000_000


class Credits:
    """Which lines may be exposed: those that find a buffer in the camera and one in storage, whatever goes on behind.

    Lines are unpacked in order and become safe in order, so two numbers are the whole state. One waiter: control.

    Args:
        camera: Frame buffers of the camera: a line needs one from its trigger until it is unpacked.
        storage: Line buffers of the sink: a line needs one from there until it is safe.
    """

    def __init__(self, camera: int, storage: int) -> None:
        self._camera = camera
        self._storage = storage
        self._unpacked = 0
        self._safe = 0
        self._advanced = asyncio.Event()

    def may_store(self, line: int) -> bool:
        """Whether there is a line buffer for ``line`` now."""
        return line < self._safe + self._storage

    def may_expose(self, line: int) -> bool:
        """Whether nothing that ``line`` needs can be missing when its frame comes."""
        return line < self._unpacked + self._camera and self.may_store(line)

    async def wait(self, line: int) -> None:
        """Wait until ``line`` may be exposed."""
        while not self.may_expose(line):
            self._advanced.clear()
            await self._advanced.wait()

    def unpacked(self, line: int) -> None:
        """The camera's buffer of ``line`` is free again."""
        self._unpacked = line + 1
        self._advanced.set()

    def safe(self, lines: range) -> None:
        """The line buffers of these lines are free again."""
        if len(lines):
            self._safe = lines.stop
            self._advanced.set()


@dataclass(slots=True)
class Scan:
    """One scan under way.

    Attributes:
        course: What to take.
        camera, actuator, sink: Where from and where to.
        records: One entry a line.
        deadlines: How long to wait for what.
        credits: Which lines may be in memory. In step modes a trigger needs one, so nothing is ever dropped; in a sweep a
            frame without one is dropped and counted.
        stop: Set to finish the line under way and close.
        on_progress: Told at most four times a second.
        latencies: Of the moves so far, with look-ahead.
        exposed: Lines whose exposure has ended, from control to receive; None ends it.
        filled: Lines to be stored, from receive to write; None ends it.
        handed_over: Released as each line has gone to storage: what a sequential scan waits for.
        taken: Lines received so far, whole or as a gap.
        begun_ns: First trigger, loop clock; in a sweep the passing of the first line, whether or not its frame comes.
        motion_over: Set when the mirror of a continuous scan stands again.
    """

    course: Course
    camera: Camera
    actuator: Actuator
    sink: LineSink
    records: LineRecords
    deadlines: Deadlines
    credits: Credits
    stop: asyncio.Event
    on_progress: Callable[[Progress], None] | None = None
    latencies: Latencies | None = None
    exposed: asyncio.Queue[int | None] = field(default_factory=asyncio.Queue[int | None])
    filled: asyncio.Queue[int | None] = field(default_factory=asyncio.Queue[int | None])
    handed_over: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(0))
    taken: int = 0
    begun_ns: int = 0
    motion_over: asyncio.Event = field(default_factory=asyncio.Event)
    _told_ns: int = 0

    @property
    def settling_s(self) -> float:
        """Within which the frame of the last trigger has arrived."""
        return self.course.settings.exposure_s + 2 * self.camera.info.readout_s + 0.1

    def tell(self) -> None:
        """Report progress, if it is time to."""
        if self.on_progress is None:
            return
        now = now_ns()
        if now - self._told_ns >= PROGRESS_INTERVAL_NS or self.taken == self.course.lines:
            self._told_ns = now
            self.on_progress(self.progress(now))

    def progress(self, now: int) -> Progress:
        """A snapshot."""
        elapsed_s = max(now - self.begun_ns, 1) * 1e-9
        missing = len(self.records.missing)
        rate = (self.taken - missing) / elapsed_s
        return Progress(
            lines=self.course.lines,
            taken=self.taken - missing,
            stored=self.records.stored,
            missing=missing,
            elapsed_s=elapsed_s,
            lines_per_second=rate,
            efficiency=self.course.settings.exposure_s * rate,
            remaining_s=(self.course.lines - self.taken) * elapsed_s / self.taken if self.taken else float("nan"),
        )

"""The state that the tasks of one scan share."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from scanhsi.clock import now_ns
from scanhsi.cube.records import Incident, LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.devices import Actuator, ActuatorInfo, Camera, CameraInfo, Light, Range
from scanhsi.engine.deadlines import Deadlines, Watch
from scanhsi.engine.lookahead import Latencies
from scanhsi.engine.plan import Course, OnFault, Recovery
from scanhsi.engine.report import Progress
from scanhsi.engine.steering import ScanControl

CAMERA_BUFFERS = 16
"""Frame buffers of the camera: a third of a second of stalled unpacking at full rate."""
PROGRESS_INTERVAL_NS = 250_000_000
FLUSH = -1
"""Instead of a line: store what is in memory."""


class Credits:
    """Which lines may be exposed: those that find a buffer in the camera and one in storage, whatever goes on behind.

    Lines are unpacked in order and become safe in order, so two numbers are the whole state.

    Args:
        camera: Frame buffers of the camera: a line needs one from its trigger until it is unpacked.
        storage: Tells the line buffers of the sink: a line needs one from there until it is safe.
        first: Lines before it are safe.
    """

    def __init__(self, camera: int, storage: Callable[[], int], first: int = 0) -> None:
        self._camera = camera
        self._storage = storage
        self._unpacked = first
        self._handed_over = first
        self._safe = first
        self._advanced = asyncio.Event()

    def may_store(self, line: int) -> bool:
        """Whether there is a line buffer for ``line`` now."""
        return line < self._safe + self._storage()

    def may_expose(self, line: int) -> bool:
        """Whether nothing that ``line`` needs can be missing when its frame comes."""
        return line < self._unpacked + self._camera and self.may_store(line)

    async def wait(self, line: int) -> None:
        """Wait until ``line`` may be exposed."""
        while not self.may_expose(line):
            self._advanced.clear()
            await self._advanced.wait()

    async def turn(self, line: int) -> None:
        """Wait until the lines before ``line`` have gone to storage: what a sequential scan does."""
        while self._handed_over < line:
            self._advanced.clear()
            await self._advanced.wait()

    def unpacked(self, line: int) -> None:
        """The camera's buffer of ``line`` is free again."""
        self._unpacked = line + 1
        self._advanced.set()

    def handed_over(self, line: int) -> None:
        """A line has gone to storage."""
        self._handed_over = line + 1
        self._advanced.set()

    def safe(self, lines: range) -> None:
        """The line buffers of these lines are free again."""
        if len(lines):
            self._safe = lines.stop
            self._advanced.set()


@dataclass(slots=True)
class Leg:
    """A stretch of a scan without interruption; the camera is armed once.

    Attributes:
        first: Its first line: exposure 0 of the camera.
        exposed: Lines whose exposure has ended, from control to receive; None ends it.
        motion_over: Set when the mirror of a continuous scan stands again.
        cut: Whether a sweep was ended before its last line, because somebody asked for that.
    """

    first: int
    exposed: asyncio.Queue[int | None] = field(default_factory=asyncio.Queue[int | None])
    motion_over: asyncio.Event = field(default_factory=asyncio.Event)
    cut: bool = False


@dataclass(slots=True)
class Faults:
    """The faults of a scan so far, and what is still allowed.

    Attributes:
        recovery: What the plan allows.
        tries: Line -> how often it was tried again.
        silent: Exposures in a row of which nothing was heard.
        final: Errors that nothing can mend: lines may be in the wrong place.
    """

    recovery: Recovery
    tries: Counter[int] = field(default_factory=Counter[int])
    silent: int = 0
    final: list[Exception] = field(default_factory=list[Exception])

    def may_try_again(self, line: int) -> bool:
        """Whether one more try of a line is allowed."""
        allowed = self.recovery
        return (
            allowed.on_fault is OnFault.RETRY
            and self.tries[line] < allowed.line_retries
            and self.tries.total() < allowed.retries
        )

    def beyond_repair(self, error: Exception) -> Exception:
        """Note an error as one that nothing can mend; returned, to be raised."""
        self.final.append(error)
        return error


@dataclass(slots=True)
class Hitch:
    """An incident that is not over."""

    kind: Literal["fault", "pause"]
    line: int
    at_ns: int
    device: str
    cause: str
    actions: list[str] = field(default_factory=list[str])


@dataclass(slots=True)
class Scan:
    """One scan under way.

    Attributes:
        course: What to take.
        camera, actuator, sink: Where from and where to.
        camera_info, actuator_info: What the devices were as the scan began: a lost one cannot be asked.
        limits: Steps that the mirror may be sent to.
        records: One entry a line.
        deadlines: How long to wait for what.
        watch: The watchdogs.
        credits: Which lines may be in memory. In step modes a trigger needs one, so nothing is ever dropped; in a sweep a
            frame without one is dropped and counted.
        faults: So far.
        control: Somebody's wish to stop or to pause.
        light: On from before the first line until no line is left; None where nothing can be switched.
        first: First line of this session; those before it were stored by an earlier one.
        on_progress: Told at most four times a second.
        latencies: Of the moves so far, with look-ahead.
        leg: The stretch under way.
        leg_starts: First lines of the stretches so far.
        filled: Lines to be stored, from receive to write, or `FLUSH`; None ends it.
        taken: Lines received so far, whole or as a gap.
        begun_ns: First trigger, loop clock; in a sweep the passing of the first line, whether or not its frame comes.
        dead_time_s: Of a camera that overlaps read-out; None for others.
        frame_period_s: That a free-running camera was set to.
        between: Lowest and highest step at which the mirror can stand, whatever became of the last motion; None where unknown.
        distrusted: Whether the actuator told a position that cannot be true: it is to be homed.
        earlier_incidents: Incidents of earlier sessions.
        hitch: What keeps the scan from going on.
        state: For `Progress`.
    """

    course: Course
    camera: Camera
    actuator: Actuator
    sink: LineSink
    camera_info: CameraInfo
    actuator_info: ActuatorInfo
    limits: Range
    records: LineRecords
    deadlines: Deadlines
    watch: Watch
    credits: Credits
    faults: Faults
    control: ScanControl = field(default_factory=ScanControl)
    light: Light | None = None
    first: int = 0
    on_progress: Callable[[Progress], None] | None = None
    latencies: Latencies | None = None
    leg: Leg = field(default_factory=lambda: Leg(0))
    leg_starts: list[int] = field(default_factory=list[int])
    filled: asyncio.Queue[int | None] = field(default_factory=asyncio.Queue[int | None])
    taken: int = 0
    begun_ns: int | None = None
    dead_time_s: float | None = None
    frame_period_s: float | None = None
    between: tuple[int, int] | None = None
    distrusted: bool = False
    earlier_incidents: int = 0
    hitch: Hitch | None = None
    state: str = "scanning"
    _told_ns: int = 0

    @property
    def over(self) -> bool:
        """Whether no line is left to be taken, or wanted."""
        return self.taken >= self.course.lines or self.control.stop.is_set()

    @property
    def settling_s(self) -> float:
        """Within which the frame of the last trigger has arrived."""
        return self.course.settings.exposure_s + 2 * self.camera_info.readout_s + 0.1

    def begin_leg(self) -> None:
        """From the first line on that was not received; what is known of it and those behind it does not count."""
        self.leg = Leg(self.taken)
        self.leg_starts.append(self.taken)
        if len(self.leg_starts) > 1:
            self.records.forget(self.taken)

    def hold_up(self, kind: Literal["fault", "pause"], device: str, cause: str) -> None:
        """Something keeps the scan from going on. The first cause stands until it does."""
        if self.hitch is None:
            self.hitch = Hitch(kind, self.taken, now_ns(), device, cause)

    def did(self, action: str) -> None:
        """Note what was done about it."""
        if self.hitch is not None:
            self.hitch.actions.append(action)

    def going_on(self, action: str) -> None:
        """The scan goes on, or is over; the incident goes to the records."""
        hitch, self.hitch = self.hitch, None
        if hitch is not None:
            lasted_s = (now_ns() - hitch.at_ns) * 1e-9
            actions = ", ".join([*hitch.actions, action])
            self.records.incidents.append(
                Incident(hitch.kind, hitch.line, hitch.at_ns, lasted_s, hitch.device, hitch.cause, actions)
            )
        self.tell_state("scanning")

    def tell_state(self, state: str) -> None:
        """Report progress at once when the state is another."""
        if state != self.state:
            self.state = state
            self._told_ns = -PROGRESS_INTERVAL_NS
            self.tell()

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
        elapsed_s = max(now - self.begun_ns, 1) * 1e-9 if self.begun_ns is not None else 0.0
        missing = len(self.records.missing)
        taken = self.taken - self.first
        lost = sum(line >= self.first for line in self.records.missing) if self.first else missing
        rate = (taken - lost) / elapsed_s if elapsed_s else 0.0
        return Progress(
            lines=self.course.lines,
            taken=self.taken - missing,
            stored=self.records.stored,
            missing=missing,
            elapsed_s=elapsed_s,
            lines_per_second=rate,
            efficiency=self.course.settings.exposure_s * rate,
            remaining_s=(self.course.lines - self.taken) * elapsed_s / taken if taken else float("nan"),
            state=self.state,
        )

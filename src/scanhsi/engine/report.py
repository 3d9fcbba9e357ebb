"""What a scan tells while it runs and when it has ended."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from scanhsi.clock import Granted
from scanhsi.cube.records import Incident
from scanhsi.timing.observed import StageTime


@dataclass(frozen=True, slots=True)
class Progress:
    """A snapshot of a running scan.

    Attributes:
        lines: Planned lines.
        taken: Lines whose pixels have been received and unpacked.
        stored: Lines that are safe on disk (0 when discarding).
        missing: Lines that are lost, each with its reason in the report.
        elapsed_s: Since the first trigger, loop clock.
        lines_per_second: Over the lines so far.
        efficiency: Exposure time / line period so far.
        remaining_s: Estimated time left.
        state: ``scanning``, ``paused``, ``recovering`` (a lost device) or ``warming up`` (the light).
    """

    lines: int
    taken: int
    stored: int
    missing: int
    elapsed_s: float
    lines_per_second: float
    efficiency: float
    remaining_s: float
    state: str = "scanning"


@dataclass(frozen=True, slots=True)
class Processed:
    """What became of the processing beside a scan.

    Attributes:
        output: Path of the processed cube.
        lines: Of it; 0 where it failed.
        behind: Lines that were still to be processed when the scan was over.
        caught_up_s: What these took.
        error: Why it is not whole; the raw cube is. None where all went well.
    """

    output: str
    lines: int = 0
    behind: int = 0
    caught_up_s: float = 0.0
    error: str | None = None


@dataclass(frozen=True, slots=True)
class ScanReport:
    """What a finished scan was.

    Attributes:
        mode: ``sequential``, ``stepped`` or ``continuous``.
        lines: Planned lines.
        stored: Lines safe on disk; 0 when discarding.
        missing: Lines lost.
        missing_reasons: line -> reason.
        exposure_s: Exposure time of a line.
        duration_s: First trigger to last line stored (or discarded), loop clock.
        period_s: Mean line period, between lines delivered, interruptions left out; see `scanhsi.timing.observed.deliveries`.
        lines_per_second: 1 / period.
        efficiency: T_exp / T_line (Eq. 3).
        bound_s: Shortest period that the same delays allow in this mode; None where they are not known. With look-ahead: for an
            engine that knows beforehand when each motion will begin. Of a scan that was interrupted: of its longest stretch.
        regret: period / bound; None without one.
        stages: Stage name -> its time per line.
        output: Path of the cube; None when discarded.
        simulated: Whether any device was simulated.
        stopped_early: The scan was asked to stop before its last line.
        look_ahead: Accepted probability that a line is smeared; None without look-ahead.
        smeared: Lines flagged as smeared, because the mirror began to move before their exposure had ended.
        resumed_at: First line of this session, of a cube that was resumed; None for a new one.
        retaken: Lines that were tried more than once.
        incidents: Faults and pauses on the way, what was done about them, and how long they took; earlier sessions' first.
        interrupted_s: What they took, of this session.
        real_time: The event loop, and which real-time options were asked for and granted; None where the engine was run by itself.
        processed: What became of the processing beside it; None without.
    """

    mode: str
    lines: int
    stored: int
    missing: int
    exposure_s: float
    duration_s: float
    period_s: float
    lines_per_second: float
    efficiency: float
    bound_s: float | None
    regret: float | None
    output: str | None
    simulated: bool
    stopped_early: bool = False
    look_ahead: float | None = None
    smeared: int = 0
    missing_reasons: dict[int, str] = field(default_factory=dict[int, str])
    stages: dict[str, StageTime] = field(default_factory=dict[str, StageTime])
    resumed_at: int | None = None
    retaken: int = 0
    incidents: tuple[Incident, ...] = ()
    interrupted_s: float = 0.0
    real_time: Granted | None = None
    processed: Processed | None = None

    def to_json(self) -> dict[str, Any]:
        """The report as plain JSON types."""
        return asdict(self)

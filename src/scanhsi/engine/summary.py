"""From the records of a scan to its report."""

from __future__ import annotations

import math

import numpy as np

from scanhsi.cube.records import NOT_STAMPED
from scanhsi.engine.report import ScanReport
from scanhsi.engine.scan import CAMERA_BUFFERS, Scan
from scanhsi.timing.bounds import Bound, bound
from scanhsi.timing.observed import Stamps, between, delays_of, delivered, deliveries, stage_times


def report(scan: Scan, ended_ns: int) -> ScanReport:
    """Report a scan that has ended well.

    Args:
        scan: All of its lines are stored, discarded or missing.
        ended_ns: When the last was, loop clock.
    """
    records, course = scan.records, scan.course
    exposure_s = course.settings.exposure_s
    taken = scan.taken > scan.first
    duration_s = max(ended_ns - scan.begun_ns, 0) * 1e-9 if taken and scan.begun_ns is not None else 0.0
    ours = {stage: column[scan.first :] for stage, column in records.stamps.items()}
    breaks = [line - scan.first for line in scan.leg_starts]
    legs = between(ours, breaks)
    period_s = _period_s(legs, duration_s)
    reached = _reached(scan, max(legs, key=lambda stamps: len(stamps["received"])))
    return ScanReport(
        mode=course.mode,
        lines=course.lines,
        stored=records.stored,
        missing=len(records.missing),
        exposure_s=exposure_s,
        duration_s=duration_s,
        period_s=period_s,
        lines_per_second=1 / period_s,
        efficiency=exposure_s / period_s,
        bound_s=reached.period_s if reached else None,
        regret=reached.regret if reached else None,
        output=scan.sink.output,
        simulated=scan.camera_info.simulated or scan.actuator_info.simulated,
        stopped_early=scan.taken < course.lines,
        look_ahead=course.look_ahead,
        smeared=int(records.smeared.sum()),
        missing_reasons=dict(sorted(records.missing.items())),
        stages=stage_times(ours, breaks),
        resumed_at=scan.first or None,
        retaken=int(np.count_nonzero(records.attempt > 1)),
        incidents=tuple(records.incidents),
        interrupted_s=sum(incident.lasted_s for incident in records.incidents[scan.earlier_incidents :]),
    )


def _period_s(legs: list[Stamps], duration_s: float) -> float:
    """Mean distance of lines delivered in one leg; what a single line took; nan where none came, or all at the same moment."""
    arrived = [deliveries(stamps) for stamps in legs]
    distances = sum(len(times) - 1 for times in arrived if len(times))
    if distances:
        return sum(int(times[-1] - times[0]) for times in arrived if len(times)) * 1e-9 / distances or math.nan
    return duration_s or math.nan if any(len(times) for times in arrived) else math.nan


def _reached(scan: Scan, stamps: Stamps) -> Bound | None:
    """How close a leg came to what its delays allow."""
    starts, delays = delays_of(
        stamps,
        exposure_ns=round(scan.course.settings.exposure_s * 1e9),
        readout_ns=round(scan.camera_info.readout_s * 1e9),
        dead_ns=round((scan.dead_time_s or 0.0) * 1e9),
        overlap=scan.dead_time_s is not None,
        buffers=CAMERA_BUFFERS,
        look_ahead=scan.course.look_ahead is not None,
    )
    exposed = stamps["exposure_start"] != NOT_STAMPED
    return bound(starts, delivered(stamps)[exposed], delays, scan.course.mode)

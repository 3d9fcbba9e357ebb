"""From the records of a scan to its report."""

from __future__ import annotations

from scanhsi.cube.records import NOT_STAMPED
from scanhsi.devices import OverlapsReadout
from scanhsi.engine.report import ScanReport
from scanhsi.engine.scan import CAMERA_BUFFERS, Scan
from scanhsi.timing.bounds import bound, mean_period_ns
from scanhsi.timing.observed import delays_of, delivered, deliveries, stage_times


def report(scan: Scan, ended_ns: int) -> ScanReport:
    """Report a scan that has ended well.

    Args:
        scan: All of its lines are stored, discarded or missing.
        ended_ns: When the last was, loop clock.
    """
    records, course, camera = scan.records, scan.course, scan.camera
    exposure_s = course.settings.exposure_s
    duration_s = max(ended_ns - scan.begun_ns, 0) * 1e-9 if scan.taken else 0.0
    arrived_ns = deliveries(records.stamps)
    period_s = duration_s if len(arrived_ns) == 1 else mean_period_ns(arrived_ns) * 1e-9
    starts, delays = delays_of(
        records.stamps,
        exposure_ns=round(exposure_s * 1e9),
        readout_ns=round(camera.info.readout_s * 1e9),
        dead_ns=round(camera.dead_time_s() * 1e9) if isinstance(camera, OverlapsReadout) else 0,
        overlap=isinstance(camera, OverlapsReadout),
        buffers=CAMERA_BUFFERS,
        look_ahead=course.look_ahead is not None,
    )
    exposed = records.stamps["exposure_start"] != NOT_STAMPED
    reached = bound(starts, delivered(records.stamps)[exposed], delays, course.mode)
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
        simulated=camera.info.simulated or scan.actuator.info.simulated,
        stopped_early=scan.taken < course.lines,
        look_ahead=course.look_ahead,
        smeared=int(records.smeared.sum()),
        missing_reasons=dict(sorted(records.missing.items())),
        stages=stage_times(records.stamps),
    )

"""The scan engine: the only code that puts devices into sequence."""

from scanhsi.engine.plan import Course, Mode, OnFault, Recovery, ScanPlan
from scanhsi.engine.report import Progress, ScanReport
from scanhsi.engine.run import run_scan
from scanhsi.engine.steering import ScanControl

__all__ = [
    "Course",
    "Mode",
    "OnFault",
    "Progress",
    "Recovery",
    "ScanControl",
    "ScanPlan",
    "ScanReport",
    "run_scan",
]

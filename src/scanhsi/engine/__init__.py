"""The scan engine: the only code that puts devices into sequence."""

from scanhsi.engine.plan import Course, Mode, ScanPlan
from scanhsi.engine.report import Progress, ScanReport
from scanhsi.engine.run import run_scan

__all__ = ["Course", "Mode", "Progress", "ScanPlan", "ScanReport", "run_scan"]

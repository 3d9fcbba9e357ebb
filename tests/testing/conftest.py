"""Says which scans are drawn today, so that a failure of yesterday can be run again."""

from __future__ import annotations

from scanhsi.testing.fuzz import today


def pytest_report_header() -> str:
    return f"scanhsi-fuzz: seed of the day {today()}"

"""The results of benchmarks, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

if TYPE_CHECKING:
    from scanhsi.bench.curves import Curve
    from scanhsi.bench.engine import LoopReport, Percentiles


def curve_table(fitted: list[Curve]) -> Table:
    """The law of each curve."""
    caption = "line period = T + added, or max(T + added, floor), for exposures T; ± is half of the 95 % interval"
    table = Table(box=None, padding=(0, 1, 0, 0), caption=caption, header_style="bold")
    for column in ("mode", "scenario", "format"):
        table.add_column(column, no_wrap=True)
    for column in ("added, ms", "floor, ms", "limit, 1/s", "at 100 ms"):
        table.add_column(column, justify="right", no_wrap=True)
    for curve in fitted:
        law = curve.law
        floor = "-" if law.floor is None else str(law.floor)
        table.add_row(
            *(curve.mode, curve.scenario, curve.pixel_format, str(law.added), floor),
            "-" if law.limit_lps is None else f"{law.limit_lps:.2f}",
            f"{law.efficiency(0.1):.1%}",
        )
    return table


def lost_lines(fitted: list[Curve]) -> list[str]:
    """Where lines were lost, and how many."""
    return [
        f"{curve.missing} of {curve.lines} lines lost: {curve.mode}, {curve.scenario}, {curve.pixel_format}"
        for curve in fitted
        if curve.missing
    ]


def engine_table(reports: list[LoopReport]) -> Table:
    """CPU time and latencies, loop beside loop."""
    hogs = reports[0].hogs
    caption = f"with {hogs} busy processes beside it" if hogs else "with nothing else started beside it"
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=caption)
    for column in ("us", "loop"):
        table.add_column(column, no_wrap=True)
    for column in ("least", "p50", "p95", "p99", "most"):
        table.add_column(column, justify="right", no_wrap=True)
    for mode in reports[0].cpu:
        for report in reports:
            cost = report.cpu[mode]
            table.add_row(f"CPU a line, {mode}", report.loop, f"{cost.min_us:.1f}", f"{cost.median_us:.1f}")
    for name, times in (("wake-up", _wake_up), ("timer late by", _jitter)):
        for report in reports:
            told = times(report)
            numbers = (told.p50_us, told.p95_us, told.p99_us, told.max_us)
            table.add_row(name, report.loop, "", *(f"{number:.0f}" for number in numbers))
    return table


def _wake_up(report: LoopReport) -> Percentiles:
    return report.wake_up


def _jitter(report: LoopReport) -> Percentiles:
    return report.jitter

"""The results of benchmarks, for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

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


def engine_tables(reports: list[LoopReport]) -> Iterator[RenderableType]:
    """CPU time and latencies of each load, loop beside loop; then regret."""
    for hogs in dict.fromkeys(report.hogs for report in reports):
        yield _latencies([report for report in reports if report.hogs == hogs])
    yield _regrets(reports)
    with_options = next((report.real_time for report in reports if report.real_time.asked), None)
    if with_options is not None:
        yield Text(f"+ with {with_options}", style="dim")


def _latencies(reports: list[LoopReport]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=_beside(reports[0].hogs), title_justify="left")
    for column in ("us", "loop"):
        table.add_column(column, no_wrap=True)
    for column in ("least", "p50", "p95", "p99", "most"):
        table.add_column(column, justify="right", no_wrap=True)
    for mode in reports[0].cpu:
        for report in reports:
            cost = report.cpu[mode]
            table.add_row(f"CPU a line, {mode}", _loop(report), f"{cost.min_us:.1f}", f"{cost.median_us:.1f}")
    for name, times in (("wake-up", _wake_up), ("timer late by", _jitter)):
        for report in reports:
            told = times(report)
            numbers = (told.p50_us, told.p95_us, told.p99_us, told.max_us)
            table.add_row(name, _loop(report), "", *(f"{number:.0f}" for number in numbers))
    return table


def _regrets(reports: list[LoopReport]) -> Table:
    told = reports[0].regret
    title = f"stepped scans of {told.lines} lines of {told.exposure_s * 1e3:g} ms, simulated devices"
    least = f"{told.bound_s * 1e3:.2f} ms a line"
    caption = f"regret: time taken / least that the drawn delays allow ({least}); {len(told.runs)} scans each"
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=title, title_justify="left", caption=caption)
    for column in ("", "loop"):
        table.add_column(column, no_wrap=True)
    for column in ("least", "regret", "most", "excess a line"):
        table.add_column(column, justify="right", no_wrap=True)
    for report in reports:
        regret = report.regret
        spread = (f"{value:.4f}" for value in (min(regret.runs), regret.median, max(regret.runs)))
        table.add_row(_beside(report.hogs), _loop(report), *spread, f"{regret.excess_s * 1e3:.2f} ms")
    return table


def _loop(report: LoopReport) -> str:
    return f"{report.loop} +" if report.real_time.asked else report.loop


def _beside(hogs: int) -> str:
    return f"{hogs} busy processes" if hogs else "no busy process"


def _wake_up(report: LoopReport) -> Percentiles:
    return report.wake_up


def _jitter(report: LoopReport) -> Percentiles:
    return report.jitter

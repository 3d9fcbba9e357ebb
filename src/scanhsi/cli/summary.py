"""The facts of a scan, for people: a headline, a timing table, what was lost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from scanhsi.instrument.quantities import format_quantity
from scanhsi.timing.smear import motion_mtf, period_for_smear_s, smear_part

if TYPE_CHECKING:
    from scanhsi.clock import Granted
    from scanhsi.cube.records import Incident
    from scanhsi.engine import ScanReport
    from scanhsi.timing.observed import StageTime

MOST_SMEAR = 0.5
"""Part of a line from which on a sweep's smear is warned of, unless asked otherwise."""
_MOST_REASONS = 10


def scan_summary(report: ScanReport) -> RenderableType:
    """What ``scanhsi scan`` says at the end."""
    taken = math.isfinite(report.period_s)  # a scan that is stopped before its first line has no speed
    return Group(
        facts(
            {
                "result": _result(report),
                "simulated": Text("SIMULATED, not measured", style="bold yellow") if report.simulated else None,
                "cube": report.output or "discarded",
                "finish it": f"scanhsi scan --resume {report.output}"
                if report.output and report.stopped_early
                else None,
                "mode": report.mode,
                "speed": f"{report.lines_per_second:.2f} lines/s, {duration(report.period_s)} a line, "
                f"{duration(report.duration_s)} in all"
                if taken
                else None,
                "efficiency": f"{report.efficiency:.1%} of the time exposing {duration(report.exposure_s)} a line"
                if taken
                else None,
                "look-ahead": look_ahead(report.look_ahead, report.smeared),
                "bound": bound(report.bound_s, report.regret),
                "real time": _real_time(report.real_time),
                "resumed": f"at line {report.resumed_at}" if report.resumed_at else None,
                "interrupted": interruptions(report.incidents, report.retaken),
            }
        ),
        stage_table(report.stages),
        *incident_lines(report.incidents),
        *missing_lines(report.missing_reasons),
    )


def facts(rows: Mapping[str, str | Text | None]) -> RenderableType:
    """Names and values, without those that are None."""
    table = Table.grid(padding=(0, 2))
    for name, value in rows.items():
        if value is not None:
            table.add_row(Text(name, style="bold"), value if isinstance(value, Text) else Text(value))
    return table


def stage_table(stages: Mapping[str, StageTime]) -> RenderableType:
    """How long each stage of a line took."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("time per line")
    for column in ("mean", "median", "99 %", "longest"):
        table.add_column(column, justify="right")
    for name, stage in stages.items():
        table.add_row(name, *(duration(value) for value in (stage.mean_s, stage.p50_s, stage.p99_s, stage.max_s)))
    return table


def missing_lines(reasons: Mapping[int, str]) -> list[RenderableType]:
    """Which lines were lost and why, the first of them."""
    shown = [
        Text(f"line {line} lost: {reason}", style="yellow") for line, reason in list(reasons.items())[:_MOST_REASONS]
    ]
    more = len(reasons) - len(shown)
    return [*shown, Text(f"and {more} more", style="yellow")] if more else [*shown]


def _several(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def interruptions(incidents: Sequence[Incident], retaken: int) -> Text | None:
    """How often and for how long something kept a scan from going on; None where nothing did."""
    if not incidents:
        return None
    faults = sum(incident.kind == "fault" for incident in incidents)
    lasted = duration(sum(each.lasted_s for each in incidents))
    told = f"{_several(faults, 'fault')}, {_several(len(incidents) - faults, 'pause')}, {lasted} in all"
    return Text(f"{told}; {_several(retaken, 'line')} taken more than once", style="yellow" if faults else "")


def incident_lines(incidents: Sequence[Incident]) -> list[RenderableType]:
    """What kept a scan from going on, the first of it."""
    shown = [
        Text(f"{each.kind} at line {each.line}, {duration(each.lasted_s)}: {each.cause.rstrip('.')}: {each.action}")
        for each in incidents[:_MOST_REASONS]
    ]
    more = len(incidents) - len(shown)
    return [*shown, Text(f"and {more} more")] if more else [*shown]


def bound(bound_s: float | None, regret: float | None) -> str | None:
    """How close the scan came to what the same delays allow."""
    if bound_s is None or regret is None:
        return None
    return f"{duration(bound_s)} a line is the shortest these delays allow; the scan took {regret:.4f} times the least"


def smear_warning(exposure_s: float, period_s: float, most: float = MOST_SMEAR) -> str | None:
    """What a sweep costs in contrast, where it smears more than ``most`` of a line."""
    part = smear_part(exposure_s, period_s)
    if not part > most + 1e-9:
        return None
    enough = duration(period_for_smear_s(exposure_s, most))
    return (
        f"continuous: the mirror moves on by up to {part:.0%} of a line while it is exposed, which leaves {motion_mtf(part):.0%} "
        f"of the contrast of the finest detail (Nyquist). A period of {enough} would keep it at {most:.0%}."
    )


def accepted_smear(probability: float, lines: int) -> str:
    """What look-ahead accepts, said before a scan."""
    if not probability:
        return "look-ahead: moves are sent early only as far as is sure; no line is expected to be smeared"
    return (
        f"look-ahead: each line is smeared with a probability of up to {probability:.3g}, "
        f"{probability * lines:.3g} of {lines} lines expected at most; such lines are flagged"
    )


def look_ahead(probability: object, smeared: int) -> Text | None:
    """What look-ahead accepted, and what came of it; None without look-ahead."""
    if not isinstance(probability, float | int):
        return None
    found = f"{smeared} lines flagged as smeared, accepted was a probability of {probability:.3g} a line"
    return Text(found, style="yellow" if smeared else "")


def duration(seconds: float) -> str:
    """A time to four digits, in the unit that fits."""
    return format_quantity(seconds, "s", digits=4) if math.isfinite(seconds) else "unknown"


def _real_time(told: Granted | None) -> Text | None:
    """Nothing where nothing was asked for."""
    return Text(str(told), style="yellow" if told.refused else "") if told and told.asked else None


def _result(report: ScanReport) -> Text:
    kept = (
        f"{report.stored} of {report.lines} lines stored"
        if report.output
        else f"{report.lines} lines taken and discarded"
    )
    if report.stopped_early:
        return Text(f"stopped early: {kept}, {report.missing} lost", style="bold yellow")
    if report.missing:
        return Text(f"incomplete: {kept}, {report.missing} lost", style="bold red")
    return Text(kept, style="bold green")

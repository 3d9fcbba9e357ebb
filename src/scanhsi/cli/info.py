"""``scanhsi info``."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from scanhsi.cli.output import results, write_json

if TYPE_CHECKING:
    from scanhsi.cube.reader import CubeSummary


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(info)


def info(
    cube: Annotated[str, typer.Argument(help="Cube to tell about: a folder, or a URL of an object store.")],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell what a cube holds: its plan, shape, lines stored and missing, time per stage, efficiency.

    [bold]Example[/]: scanhsi info hand.zarr
    """
    from scanhsi.cube.reader import cube_summary, read_records
    from scanhsi.timing.observed import stage_times

    summary = cube_summary(cube)
    records = read_records(cube) if summary.shape[1] else None
    runs = _runs(summary, records.run.tolist()) if records else []
    incidents = records.incidents if records else []
    breaks = [*(each.line for each in incidents), *(run["first"] for run in runs)]
    stages = stage_times(records.stamps, breaks) if records else {}
    smeared = int(records.smeared.sum()) if records else 0
    retaken = int((records.attempt > 1).sum()) if records else 0
    period_s = stages["line"].mean_s if "line" in stages else None
    exposure_s = _plan(summary).get("exposure_s")
    efficiency = exposure_s / period_s if period_s and isinstance(exposure_s, float) else None
    if json:
        write_json(
            {
                **asdict(summary),
                "period_s": period_s,
                "lines_per_second": 1 / period_s if period_s else None,
                "efficiency": efficiency,
                "lines_smeared": smeared,
                "lines_retaken": retaken,
                "runs": runs,
                "incidents": [each.to_json() for each in incidents],
                "stages": {name: asdict(stage) for name, stage in stages.items()},
            }
        )
        return
    from scanhsi.cli.summary import facts, incident_lines, interruptions, missing_lines, stage_table

    console = results()
    console.print(_facts(summary, period_s, efficiency, smeared))
    console.print(facts({"interrupted": interruptions(incidents, retaken)}))
    for run in runs if len(runs) > 1 else ():
        console.print(f"lines {run['first']} to {run['last']}: run {run['run']}, {run['at']}")
    if stages:
        console.print(stage_table(stages))
    for line in incident_lines(incidents):
        console.print(line)
    for line in missing_lines(summary.missing_reasons):
        console.print(line)


def _runs(summary: CubeSummary, numbers: list[int]) -> list[dict[str, Any]]:
    """Which lines each session took: first and last line, the session's name, and when it began."""
    told = summary.attributes
    acquisition, resumed = told.get("acquisition", {}), told.get("resumed", [])
    sessions = [{"run": told.get("run"), "at": acquisition.get("started")}, *resumed]
    found: list[dict[str, Any]] = []
    for number in sorted(set(numbers)):
        lines = [line for line, run in enumerate(numbers) if run == number]
        session = sessions[number] if number < len(sessions) else {}
        found.append({"first": lines[0], "last": lines[-1], "run": session.get("run"), "at": session.get("at")})
    return found


def _plan(summary: CubeSummary) -> dict[str, Any]:
    plan = summary.attributes.get("plan")
    return cast("dict[str, Any]", plan) if isinstance(plan, dict) else {}


def _facts(summary: CubeSummary, period_s: float | None, efficiency: float | None, smeared: int) -> Any:
    from rich.text import Text

    from scanhsi.cli.summary import duration, facts, look_ahead
    from scanhsi.instrument.quantities import format_quantity

    bands, lines, samples = summary.shape
    exposure_s, gain_db = _plan(summary).get("exposure_s"), _plan(summary).get("gain_db")
    state = f"{summary.lines_stored} of {summary.lines_planned} lines stored, {summary.lines_missing} lost"
    whole = summary.complete and not summary.lines_missing
    return facts(
        {
            "cube": summary.path,
            "state": Text(state if summary.complete else f"incomplete: {state}", style="green" if whole else "yellow"),
            "simulated": Text("SIMULATED, not measured", style="bold yellow") if summary.simulated else None,
            "shape": f"{bands} bands x {lines} lines x {samples} samples, {summary.dtype}"
            f"{_bits(summary)}, {format_quantity(summary.size_bytes, 'B', digits=3)} on disk",
            "wavelength": None
            if summary.wavelength_nm is None
            else "{:.1f} to {:.1f} nm".format(*summary.wavelength_nm),
            "plan": ", ".join(f"{key} {value}" for key, value in _shown_plan(_plan(summary)).items()) or None,
            "exposure": None if exposure_s is None else f"{duration(exposure_s)} at {gain_db:g} dB",
            "speed": None if period_s is None else f"{1 / period_s:.2f} lines/s, {duration(period_s)} a line",
            "efficiency": None if efficiency is None else f"{efficiency:.1%}",
            "real time": _real_time(summary),
            "look-ahead": look_ahead(_plan(summary).get("look_ahead"), smeared),
        }
    )


def _bits(summary: CubeSummary) -> str:
    return "" if summary.significant_bits is None else f" ({summary.significant_bits} bits)"


def _real_time(summary: CubeSummary) -> str | None:
    """Options that were asked for; None where there were none."""
    told = summary.attributes.get("real_time")
    if not isinstance(told, dict):
        return None
    from scanhsi.clock import Granted

    options = Granted(**cast("dict[str, Any]", told))
    return str(options) if options.asked else None


def _shown_plan(plan: dict[str, Any]) -> dict[str, Any]:
    elsewhere = {"exposure_s", "gain_db", "look_ahead", "line_retries", "retries", "recover_within_s"}
    if plan.get("on_fault") == "skip":
        elsewhere.add("on_fault")
    return {key: value for key, value in plan.items() if key not in elsewhere and value is not None}

"""``scanhsi delays``."""

from __future__ import annotations

import json as json_text
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanhsi.cli.delays_compare import compare
from scanhsi.cli.output import messages, results, write_json

if TYPE_CHECKING:
    from scanhsi.cube.reader import CubeSummary
    from scanhsi.timing.delays import DelayProfile, Dependence
    from scanhsi.timing.observed import StageTime
    from scanhsi.timing.recording import Recording

_SHOWN = 10_240
"""Delays drawn of each stream for `show`."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    delays = typer.Typer(no_args_is_help=True, help="Record the delays of an instrument, look at them, compare them.")
    delays.command()(record)
    delays.command()(show)
    delays.command()(compare)
    app.add_typer(delays, name="delays")


def record(
    cubes: Annotated[list[str], typer.Argument(metavar="CUBE", help="Cubes of one instrument; folders or URLs.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="PROFILE.json", help="Profile to write; replaced if it exists.")
    ],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Turn the stamps of scans into a delay profile, for `scanhsi predict --delays` and for simulated devices.

    [bold]Example[/]: scanhsi delays record monday.zarr tuesday.zarr -o mine.json
    """
    if output.suffix.lower() != ".json":
        raise typer.BadParameter(f"{output} is not a .json file.", param_hint="--output")
    from scanhsi.cube.reader import cube_summary
    from scanhsi.devices.errors import CubeError
    from scanhsi.timing.recording import profile_of

    summaries = [cube_summary(cube) for cube in cubes]
    for summary in summaries:
        absent = [key for key in ("plan", "run", "devices") if key not in summary.attributes]
        if absent:
            raise CubeError(f"{summary.path} does not tell its {', '.join(absent)}: record cubes that scanhsi scanned.")
    real = all(summary.simulated is False for summary in summaries)
    profile = profile_of(
        [_recording(summary) for summary in summaries],
        name=output.stem,
        source=_source(summaries),
        mark="measured" if real else "SIMULATED: measured on simulated devices",
        readout_s=float(summaries[-1].attributes["devices"]["camera"].get("readout_s") or 0.0),
    )
    try:
        output.write_text(_text(profile), encoding="utf-8")
    except OSError as error:
        raise CubeError(f"cannot write {output}: {error.strerror or error}.") from error
    if json:
        write_json({"output": str(output), **_described(profile)})
    else:
        messages().print(f"{len(profile.streams)} streams ({profile.mark}) in {output}", soft_wrap=True)


def show(
    profile: Annotated[Path, typer.Argument(help="Delay profile.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="PNG", help="Figure to write, with a PDF beside it.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show a delay profile: a table, and with -o a figure of how often each delay is exceeded.

    [bold]Example[/]: scanhsi delays show mine.json -o mine.png
    """
    if output is not None and output.suffix.lower() != ".png":
        raise typer.BadParameter(f"{output} is not a .png file.", param_hint="--output")
    from scanhsi.timing.delays import load_profile

    loaded = load_profile(profile)
    if output is not None:
        from scanhsi.bench.delay_figure import draw_delays
        from scanhsi.bench.style import save

        save(lambda: draw_delays(loaded, _SHOWN), output.parent, output.stem)
    if json:
        write_json({"output": None if output is None else str(output), **_described(loaded)})
    else:
        _show(loaded)


def _recording(summary: CubeSummary) -> Recording:
    from scanhsi.cube.reader import read_records
    from scanhsi.timing.recording import Recording

    plan = summary.attributes["plan"]
    return Recording(
        stamps=read_records(summary.path).stamps,
        exposure_ns=round(plan["exposure_s"] * 1e9),
        pixel_format=plan["pixel_format"],
        steps=plan["step"],
        mode=plan["mode"],
        run=summary.attributes["run"],
    )


def _source(summaries: Sequence[CubeSummary]) -> str:
    """Scans and devices, in words."""
    scans = [_scan(summary) for summary in summaries]
    devices = dict.fromkeys(_devices(summary.attributes["devices"]) for summary in summaries)
    return f"{'; '.join(scans)}. Devices: {'; '.join(devices)}."


def _scan(summary: CubeSummary) -> str:
    plan, roi = summary.attributes["plan"], f"{summary.shape[0]} x {summary.shape[2]} pixels kept"
    run, started = summary.attributes["run"], summary.attributes["acquisition"]["started"]
    simulated = "" if summary.simulated is False else "SIMULATED "
    exposure = f"{plan['exposure_s'] * 1e3:g} ms"
    return f"{simulated}run {run} of {started}, {summary.shape[1]} lines, {plan['mode']}, {plan['pixel_format']}, {exposure}, {roi}"


def _devices(devices: dict[str, Any]) -> str:
    known = ("vendor", "model", "serial", "firmware")
    told = [[str(devices[role][key]) for key in known if devices[role].get(key)] for role in ("camera", "actuator")]
    return f"{devices['name']}: {' '.join(told[0])} and {' '.join(told[1])}"


def _text(profile: DelayProfile) -> str:
    """The profile as JSON, one line a stream and one a scan."""
    known = profile.model_dump(mode="json", by_alias=True, exclude_none=True, exclude={"streams", "scans"})
    streams = {
        name: model.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        for name, model in profile.streams.items()
    }
    rows = [f"    {json_text.dumps(name)}: {json_text.dumps(model)}" for name, model in streams.items()]
    scans = [f"    {scan.model_dump_json()}" for scan in profile.scans]
    head, whole_streams, whole_scans = json_text.dumps(known, indent=2)[:-2], ",\n".join(rows), ",\n".join(scans)
    return f'{head},\n  "streams": {{\n{whole_streams}\n  }},\n  "scans": [\n{whole_scans}\n  ]\n}}\n'


def _described(profile: DelayProfile) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "name": profile.name,
        "mark": profile.mark,
        "source": profile.source,
        "notes": {stream: model.note for stream, model in profile.streams.items()},
        "dependence": {
            stream: model.dependence.model_dump(mode="json")
            for stream, model in profile.streams.items()
            if model.dependence
        },
        "lines": sum(scan.lines for scan in profile.scans),
        "streams": {name: asdict(time) for name, time in _times(profile).items()},
    }


def _times(profile: DelayProfile) -> dict[str, StageTime]:
    import numpy as np

    from scanhsi.timing.delays import DelayStreams
    from scanhsi.timing.observed import StageTime

    drawn = DelayStreams(profile, 0)
    times: dict[str, StageTime] = {}
    for stream, model in profile.streams.items():
        for kind in model.by_format or (None,):
            delays_s = drawn.array_ns(stream, _SHOWN, pixel_format=kind) * 1e-9
            p50, p99, most = np.quantile(delays_s, (0.5, 0.99, 1)).tolist()
            more = f" + {profile.per_step_s(stream) * 1e3:g} ms a step" if model.per_step else ""
            name = f"{stream} {kind or ''}".rstrip() + more
            times[name] = StageTime(profile.mean_s(stream, pixel_format=kind), p50, p99, most)
    return times


def _show(profile: DelayProfile) -> None:
    from rich.text import Text

    from scanhsi.cli.summary import facts, stage_table

    console = results()
    mark = Text(profile.mark, style="bold yellow")
    lines = sum(scan.lines for scan in profile.scans)
    kept = f"{lines} recorded lines, replayed in blocks" if lines else None
    console.print(facts({"delays": profile.name, "trust": mark, "source": profile.source, "lines": kept}))
    console.print(stage_table(_times(profile)))
    for stream, model in profile.streams.items():
        known = f" ({_told(model.dependence)})" if model.dependence else ""
        console.print(Text(f"{stream}: {model.note}{known}", style="dim"))


def _told(known: Dependence) -> str:
    acf = ", ".join(f"{rho:.2f} at lag {lag}" for lag, rho in known.acf.items())
    rank = f"; rank autocorrelation {acf}" if acf else ""
    return f"{known.n} lines, worth {known.n / known.length:.0f} independent ones{rank}"

"""``scanhsi predict``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from scanhsi.cli.output import results, write_json
from scanhsi.cli.scan import parsed_settings

if TYPE_CHECKING:
    from rich.console import RenderableType

    from scanhsi.engine import ScanPlan
    from scanhsi.timing.devices import InstrumentTiming
    from scanhsi.timing.prediction import Gain, Prediction


_WIDE: Final = 110
"""Columns of a terminal from which on the terms of the slowest circuit fit beside its name."""
_ACCEPTED: Final = 0.01
"""Probability of a smeared line with which look-ahead is told of, where the plan has none."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(predict)


def predict(
    instrument: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped instrument (sensors2019, characterise, twin), or path of an instrument file."
        ),
    ] = "sensors2019",
    mode: Annotated[str | None, typer.Option(help="Mode of which to tell what shorter delays would gain.")] = None,
    lines: Annotated[str | None, typer.Option(metavar="N", help="Lines of the cube.")] = None,
    step: Annotated[str | None, typer.Option(metavar="STEPS", help="Motor steps between lines.")] = None,
    exposure: Annotated[str | None, typer.Option(metavar="TIME", help='With its unit: "20 ms".')] = None,
    pixel_format: Annotated[
        str | None, typer.Option(metavar="FORMAT", help="Pixel format of which to tell what shorter delays would gain.")
    ] = None,
    period: Annotated[
        str | None, typer.Option(metavar="TIME", help="Line period of continuous scans; default: the shortest.")
    ] = None,
    delays: Annotated[
        Path | None,
        typer.Option(metavar="PROFILE.json", help="Delays of the devices, instead of those that the drivers tell."),
    ] = None,
    most_smear: Annotated[
        float, typer.Option(min=0.01, help="Warn where a continuous scan smears more than this part of a line.")
    ] = 0.5,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the instrument file; repeatable."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Predict what a scan costs, for every mode and pixel format, and what to improve. Nothing is connected or moved.

    [bold]Example[/]: scanhsi predict sensors2019 --exposure "20 ms" --lines 1200
    """
    from scanhsi.imager import default_plan
    from scanhsi.instrument import load_instrument
    from scanhsi.instrument.timing import timing_of
    from scanhsi.timing.delays import load_profile
    from scanhsi.timing.prediction import gains, predict_all

    config = load_instrument(instrument, parsed_settings(settings or ()))
    given = {"mode": mode, "lines": lines, "step": step, "exposure": exposure, "pixel_format": pixel_format}
    plan = default_plan(config, **{name: value for name, value in given.items() if value is not None})
    sweep = default_plan(config, mode="continuous", **({} if period is None else {"period": period}))
    timing = timing_of(config, load_profile(delays) if delays else None)
    _refuse_unknown(plan, timing)
    exposure_s, count, stride = plan.exposure_s, plan.lines, plan.step
    predictions = predict_all(timing, exposure_s=exposure_s, lines=count, step=stride, period_s=sweep.period_s)
    found = gains(timing, plan.mode, plan.pixel_format, exposure_s=exposure_s, lines=count, step=stride)
    if json:
        write_json(_described(config.name, plan, timing, predictions, found, most_smear))
    else:
        console = results()
        wide = console.width >= _WIDE
        for part in _shown(config.name, plan, timing, predictions, found, most_smear, wide=wide):
            console.print(part)


def _refuse_unknown(plan: ScanPlan, timing: InstrumentTiming) -> None:
    from scanhsi.devices.errors import ConfigError

    if plan.pixel_format not in timing.formats:
        known = ", ".join(timing.formats)
        raise ConfigError(f"the delays of {plan.pixel_format} are not known; those of {known or 'no format'} are.")


def _described(
    name: str,
    plan: ScanPlan,
    timing: InstrumentTiming,
    predictions: Sequence[Prediction],
    found: Sequence[Gain],
    most_smear: float,
) -> dict[str, Any]:
    terms = timing.terms(plan.exposure_s, plan.pixel_format, plan.step)
    return {
        "instrument": name,
        "plan": plan.model_dump(mode="json"),
        "marks": list(timing.marks),
        "counted_as_zero": list(timing.absent),
        "terms_s": {term: terms.get(term) for term in terms.names()},
        "predictions": [{**asdict(each), "smeared": each.smear > most_smear} for each in predictions],
        "gains_of_1_ms": [asdict(gain) for gain in found],
    }


def _shown(
    name: str,
    plan: ScanPlan,
    timing: InstrumentTiming,
    predictions: Sequence[Prediction],
    found: Sequence[Gain],
    most_smear: float,
    *,
    wide: bool,
) -> Iterator[RenderableType]:
    from rich.text import Text

    from scanhsi.cli.summary import duration, facts

    chosen = f"{plan.mode}, {plan.pixel_format}"
    lines = f"{plan.lines} lines of {duration(plan.exposure_s)}, {plan.step:+d} steps each"
    marks = Text("; ".join(timing.marks), style="bold yellow")
    absent = Text(", ".join(timing.absent), style="dim") if timing.absent else None
    yield facts({"instrument": name, "scan": lines, "delays": marks, "counted as 0": absent})
    yield _table(predictions, (plan.mode, plan.pixel_format), most_smear, wide=wide)
    yield from (Text(warning, style="yellow") for warning in _warnings(predictions, plan.exposure_s, most_smear))
    yield Text(f"\nWhat 1 ms less of each delay would gain ({chosen}):", style="bold")
    yield _gains(found) if any(_worth(gain) for gain in found) else Text("nothing: the exposure itself sets the pace.")
    if hint := _look_ahead(plan, timing, found):
        yield Text(hint)


def _table(
    predictions: Sequence[Prediction], chosen: tuple[str, str], most_smear: float, *, wide: bool
) -> RenderableType:
    from rich import box
    from rich.table import Table

    from scanhsi.cli.summary import duration

    caption = "scan: first exposure to last line stored; homing and the way to the first line come before it"
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), caption=caption)
    table.add_column("pixel format", no_wrap=True)
    for column in ("period", "lines/s", "efficiency", "scan", "smear"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("pace is set by")
    mode = None
    for each in predictions:
        if each.mode != mode:
            mode = each.mode
            table.add_row(f"[bold]{mode}[/]")
        smear = f"{each.smear:.0%}" if each.smear else "none"
        table.add_row(
            f"  {each.pixel_format}",
            duration(each.period_s),
            f"{each.lines_per_second:.2f}",
            f"{each.efficiency:.1%}",
            duration(each.scan_s),
            f"[yellow]{smear}[/]" if each.smear > most_smear else smear,
            f"{each.circuit}: {' + '.join(each.critical) or 'nothing'}" if wide else each.circuit,
            style="bold" if (each.mode, each.pixel_format) == chosen else None,
        )
    return table


def _warnings(predictions: Sequence[Prediction], exposure_s: float, most_smear: float) -> Iterator[str]:
    from scanhsi.cli.summary import smear_warning

    sweeps = [each.period_s for each in predictions if each.smear]
    warning = smear_warning(exposure_s, min(sweeps), most_smear) if sweeps else None
    if warning:
        yield warning


def _look_ahead(plan: ScanPlan, timing: InstrumentTiming, found: Sequence[Gain]) -> str | None:
    """What look-ahead would gain, where a shorter move gains anything; predictions are without."""
    from scanhsi.cli.summary import duration
    from scanhsi.timing.prediction import lead_s

    accepted = _ACCEPTED if plan.look_ahead is None else plan.look_ahead
    lead = lead_s(timing, accepted)
    if plan.mode != "stepped" or not lead or not any(gain.term == "T_act" and _worth(gain) for gain in found):
        return None
    return (
        f"--look-ahead {accepted:g} would send each move {duration(lead)} early, which is about what a line gains; "
        f"it accepts that {accepted:.1%} of the lines are smeared, and flags them."
    )


def _gains(found: Sequence[Gain]) -> RenderableType:
    from rich import box
    from rich.table import Table

    from scanhsi.cli.summary import duration

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("delay")
    for column in ("now", "a line", "the scan"):
        table.add_column(column, justify="right")
    for gain in found:
        worth = _worth(gain)
        saved = (duration(gain.period_s), duration(gain.scan_s)) if worth else ("nothing", "nothing")
        table.add_row(gain.term, duration(gain.now_s), *saved, style=None if worth else "dim")
    return table


def _worth(gain: Gain) -> bool:
    return gain.period_s > 1e-12

"""``scanhsi delays compare``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from scanhsi.cli.output import results, write_json

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from scanhsi.devices import PixelFormat
    from scanhsi.timing.comparison import ReplayComparison, ReplayPlan, StreamComparison
    from scanhsi.timing.delays import DelayProfile

_SHORT: Final = {"no difference seen": "none seen", "too few lines": "too few"}
_LOUD: Final = {"differ": "bold yellow", "too few": "bold"}


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Delay profile.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Delay profile to compare with it.")],
    exposure: Annotated[
        str | None,
        typer.Option(metavar="TIME", help='Of the scan to replay, with its unit: "20 ms"; default: as recorded.'),
    ] = None,
    pixel_format: Annotated[str | None, typer.Option(metavar="FORMAT", help="Mono8, Mono12Packed or Mono12.")] = None,
    lines: Annotated[
        int | None,
        typer.Option(min=2, help="Lines of a replay; default: as many as the smaller recording, 50 to 1000."),
    ] = None,
    step: Annotated[int | None, typer.Option(min=1, help="Motor steps between lines; default: as recorded.")] = None,
    period: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Line period of the sweep; default: the shortest that both cameras can follow."
        ),
    ] = None,
    buffers: Annotated[int, typer.Option(min=1, help="Line buffers of storage.")] = 16,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Tell whether two delay profiles differ, and whether that matters.

    Each stream is tested (Anderson-Darling, on lines so far apart that they are independent, corrected for the number of streams).
    Then both profiles are replayed in the same scan: line period of every mode, and lines lost in a sweep.

    [bold]Example[/]: scanhsi delays compare before.json after.json
    """
    from scanhsi.timing.closed_forms import Layout
    from scanhsi.timing.comparison import compare_replays, compare_streams, replay_plan
    from scanhsi.timing.delays import load_profile

    profiles = load_profile(first), load_profile(second)
    plan = replay_plan(
        *profiles,
        exposure_s=_seconds(exposure, "--exposure"),
        pixel_format=_format(pixel_format),
        lines=lines,
        step=step,
        period_s=_seconds(period, "--period"),
        layout=Layout(line_buffers=buffers),
    )
    streams, replays = compare_streams(*profiles), compare_replays(*profiles, plan)
    verdicts = _verdicts(profiles, streams, replays)
    if json:
        write_json(
            {
                "profiles": [{"name": each.name, "mark": each.mark, "source": each.source} for each in profiles],
                "plan": asdict(plan),
                "streams": [asdict(each) for each in streams],
                "replays": [asdict(each) for each in replays],
                "verdicts": verdicts,
            }
        )
    else:
        _show(profiles, plan, streams, replays, verdicts)


def _seconds(text: str | None, option: str) -> float | None:
    from pydantic import TypeAdapter, ValidationError

    from scanhsi.instrument.quantities import Seconds

    if text is None:
        return None
    try:
        adapter: TypeAdapter[float] = TypeAdapter(Seconds)
        value = adapter.validate_python(text)
    except ValidationError as error:
        raise typer.BadParameter(f"{text!r}: {error.errors()[0]['msg']}", param_hint=option) from error
    if not value > 0:
        raise typer.BadParameter(f"{text!r} is not longer than nothing", param_hint=option)
    return value


def _format(text: str | None) -> PixelFormat | None:
    from scanhsi.devices import PixelFormat

    known = [kind.value for kind in PixelFormat]
    if text is not None and text not in known:
        raise typer.BadParameter(f"{text!r} is none of {', '.join(known)}", param_hint="--pixel-format")
    return None if text is None else PixelFormat(text)


def _verdicts(
    profiles: Sequence[DelayProfile], streams: Sequence[StreamComparison], replays: Sequence[ReplayComparison]
) -> list[str]:
    """What it comes to, in sentences."""
    from scanhsi.timing.comparison import FEWEST

    told: list[str] = []
    bare = [profile.name for profile in profiles if not profile.scans]
    if bare:
        told.append(f"{' and '.join(bare)}: not recorded line by line, so that only replays can be compared.")
    elif not streams:
        told.append("no stream was recorded in both.")
    differ = [each for each in streams if each.verdict == "differ"]
    if differ:
        told.append(f"streams that differ: {', '.join(_name(each) for each in differ)}.")
    seen = [each.visible for each in streams if each.verdict == "no difference seen"]
    if seen:
        told.append(
            f"{'of the others no' if differ else 'no'} stream is seen to differ; with so many lines distances of "
            f"{min(seen):.2f} to {max(seen):.2f} between distribution functions would mostly be seen."
        )
    few = [_name(each) for each in streams if each.verdict == "too few lines"]
    if few:
        told.append(
            f"fewer than {FEWEST} independent delays, of which nothing can be told: {', '.join(few)}. Record longer scans."
        )
    matters = [each.name for each in replays if each.verdict == "differ"]
    told.append(
        f"when replayed, they differ in: {', '.join(matters)}." if matters else "when replayed, no difference is seen."
    )
    return told


def _name(stream: StreamComparison) -> str:
    return f"{stream.stream} {stream.pixel_format or ''}".rstrip()


def _show(
    profiles: tuple[DelayProfile, DelayProfile],
    plan: ReplayPlan,
    streams: Sequence[StreamComparison],
    replays: Sequence[ReplayComparison],
    verdicts: Sequence[str],
) -> None:
    from rich.text import Text

    from scanhsi.cli.summary import duration, facts

    console = results()
    marks = [Text(f"{each.name} ({each.mark})", style="bold yellow") for each in profiles]
    scan = f"{plan.lines} lines of {duration(plan.exposure_s)}, {plan.pixel_format}, {plan.step} steps each"
    sweep = f"{duration(plan.period_s)} a line, {plan.layout.line_buffers} line buffers"
    console.print(facts({"A": marks[0], "B": marks[1], "replayed": scan, "lines lost in": f"a sweep with {sweep}"}))
    if streams:
        console.print(_stream_table(streams))
    console.print(_replay_table(replays))
    for sentence in verdicts:
        console.print(Text(sentence, style="bold"))


def _stream_table(streams: Sequence[StreamComparison]) -> Table:
    table = _table("stream", "lines", "median A", "B - A", "99 % A", "B - A", "p")
    for each in streams:
        table.add_row(
            _name(each),
            f"{each.independent[0]}, {each.independent[1]}",
            _short(each.median_s[0]),
            _plus(each.median_s[1] - each.median_s[0]),
            _short(each.p99_s[0]),
            _plus(each.p99_s[1] - each.p99_s[0]),
            "" if each.verdict == "too few lines" else f"{each.p:.3f}",
            _loud(each.verdict),
        )
    return table


def _replay_table(replays: Sequence[ReplayComparison]) -> Table:
    table = _table("line period", "A", "B", "B - A", "95 % interval")
    for each in replays:
        rate = each.name == "lines lost"
        means = [f"{mean:.3%}" if rate else _short(mean) for mean in each.means]
        changes = [f"{value:+.3%}" if rate else _plus(value) for value in (each.difference, each.low, each.high)]
        table.add_row(
            each.name.removeprefix("period "), *means, changes[0], f"{changes[1]} to {changes[2]}", _loud(each.verdict)
        )
    return table


def _table(name: str, *columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column(name, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("differ?", no_wrap=True)
    return table


def _short(seconds: float) -> str:
    from scanhsi.instrument.quantities import format_quantity

    return format_quantity(seconds, "s", digits=3)


def _plus(seconds: float) -> str:
    return f"{'+' if seconds >= 0 else '-'}{_short(abs(seconds))}"


def _loud(verdict: str) -> Text:
    from rich.text import Text

    short = _SHORT.get(verdict, verdict)
    return Text(short, style=_LOUD.get(short, ""))

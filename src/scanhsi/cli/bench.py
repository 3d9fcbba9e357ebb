"""``scanhsi bench``."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from scanhsi.cli.bench_processing import processing
from scanhsi.cli.bench_storage import storage
from scanhsi.cli.bench_tables import curve_table, engine_tables, lost_lines
from scanhsi.cli.output import messages, results, write_json
from scanhsi.cli.real_time import RealTimeOption, parsed_real_time

if TYPE_CHECKING:
    from scanhsi.bench.curves import Curve
    from scanhsi.bench.observations import Observation
    from scanhsi.instrument import InstrumentConfig

_TOLD_EVERY_S = 3.0
_Word = TypeVar("_Word", bound=StrEnum)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    bench = typer.Typer(
        no_args_is_help=True, help="Measure what a line costs, what the engine costs, and what storing costs."
    )
    bench.command()(lines)
    bench.command()(draw)
    bench.command()(engine)
    bench.command()(storage)
    bench.command()(processing)
    app.add_typer(bench, name="bench")


def lines(
    instrument: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped instrument (sensors2019, characterise, twin), or path of an instrument file."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder for observations (appended) and figures (replaced)."
        ),
    ],
    exposures: Annotated[
        str | None, typer.Option(metavar="TIMES", help='As "10 ms, 20 ms"; default: 10 to 500 ms.')
    ] = None,
    formats: Annotated[str | None, typer.Option(metavar="FORMATS", help="As Mono8,Mono12; default: all.")] = None,
    modes: Annotated[str | None, typer.Option(metavar="MODES", help="As sequential,stepped; default: all.")] = None,
    scenarios: Annotated[
        str | None,
        typer.Option(metavar="SCENARIOS", help="Of full, static (mirror), acquire (and discard); default: all."),
    ] = None,
    count: Annotated[int, typer.Option("--lines", metavar="N", min=3, help="Lines of each scan.")] = 50,
    step: Annotated[int, typer.Option(metavar="STEPS", help="Motor steps between lines.")] = 1,
    virtual: Annotated[bool, typer.Option("--virtual", help="Run in virtual time.")] = False,
    real_time: RealTimeOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of simulated devices; each exposure adds its number.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Sweep exposure, pixel format, scenario and mode; fit the time of a line; draw Figs. 5, 6 and 13 of the paper.

    [bold]Example[/]: scanhsi bench lines sensors2019 --virtual -o bench
    """
    from scanhsi import clock
    from scanhsi.bench.curves import curves
    from scanhsi.bench.figures import draw_figures
    from scanhsi.bench.lines import LineSweep, measure_lines
    from scanhsi.bench.scenarios import Scenario
    from scanhsi.devices import PixelFormat
    from scanhsi.engine import Mode
    from scanhsi.instrument import load_instrument

    sweep = LineSweep(
        lines=count,
        exposures_s=None if exposures is None else [_seconds(text) for text in exposures.split(",")],
        formats=_words(PixelFormat, formats, "--formats"),
        modes=_words(Mode, modes, "--modes"),
        scenarios=_words(Scenario, scenarios, "--scenarios") or tuple(Scenario),
        step=step,
        seed=seed,
        options=parsed_real_time(real_time, virtual=virtual),
    )
    config = load_instrument(instrument)
    if virtual and not config.virtual_time:
        _refuse_virtual(config)
    began = time.monotonic()
    command = f"scanhsi bench lines {instrument}, {count} lines a scan, seed {seed}"
    with _quiet("scanhsi.instrument"):
        session = clock.run(measure_lines(config, sweep, output, command=command, tell=_teller()), virtual=virtual)
    fitted = curves(session.observations)
    figures = draw_figures(session, fitted, output)
    if json:
        write_json(
            {
                "output": str(output),
                "figures": [str(path) for path in figures],
                "simulated": session.facts["simulated"],
                "real_time": session.facts["real_time"],
                "scans": len(session.observations),
                "took_s": time.monotonic() - began,
                "curves": [_described(curve) for curve in fitted],
            }
        )
        return
    results().print(curve_table(fitted))
    for lost in lost_lines(fitted):
        results().print(lost, style="yellow")
    messages().print(f"{len(session.observations)} scans in {time.monotonic() - began:.1f} s; figures in {output}")


def draw(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of an earlier `scanhsi bench lines`.")],
) -> None:
    """Fit and draw the last session of a folder again, from its raw observations.

    [bold]Example[/]: scanhsi bench draw bench
    """
    from scanhsi.bench.curves import curves
    from scanhsi.bench.figures import draw_figures
    from scanhsi.bench.observations import OBSERVATIONS, read_sessions
    from scanhsi.devices.errors import CubeError

    sessions = read_sessions(folder / OBSERVATIONS)
    if not sessions:
        raise CubeError(f"{folder / OBSERVATIONS} holds no session.")
    fitted = curves(sessions[-1].observations)
    figures = draw_figures(sessions[-1], fitted, folder)
    results().print(curve_table(fitted))
    messages().print(f"{len(figures)} figures in {folder}")


def engine(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="JSONL", help="Append the result to this file.")
    ] = None,
    hogs: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="Measure beside N busy processes, too; default: as many as processors."),
    ] = None,
    real_time: RealTimeOption = None,
    count: Annotated[int, typer.Option("--lines", metavar="N", min=10, help="Lines of each scan.")] = 3000,
    rounds: Annotated[int, typer.Option(metavar="N", min=1, help="In which loops and loads take turns.")] = 5,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Measure the engine on our event loop and on asyncio's: CPU time a line, wake-ups, timers, and regret in real time.

    With --real-time everything is measured without and with the options.

    [bold]Example[/]: scanhsi bench engine --hogs 2 --real-time all
    """
    from scanhsi.bench.engine import Effort, measure_engine
    from scanhsi.bench.observations import append_json
    from scanhsi.bench.provenance import provenance

    options, facts = parsed_real_time(real_time), provenance()
    effort = Effort(lines=count, rounds=rounds)
    with _quiet("scanhsi.instrument"):
        reports = measure_engine(
            effort, hogs=os.cpu_count() or 1 if hogs is None else hogs, options=options, tell=messages().print
        )
    result = {"record": "engine", "schema": 2, **facts, "loops": [asdict(report) for report in reports]}
    if output is not None:
        append_json(output, result)
    if json:
        write_json(result)
    else:
        for table in engine_tables(reports):
            results().print(table)


def _words(kind: type[_Word], text: str | None, option: str) -> list[_Word] | None:
    """Comma-separated words of an enumeration."""
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    unknown = [word for word in words if word not in list(kind)]
    if unknown:
        raise typer.BadParameter(f"{', '.join(unknown)}: there are {', '.join(kind)}.", param_hint=option)
    return [kind(word) for word in words]


def _seconds(text: str) -> float:
    from pydantic import TypeAdapter, ValidationError

    from scanhsi.instrument.quantities import Seconds

    try:
        seconds: TypeAdapter[float] = TypeAdapter(Seconds)
        return seconds.validate_python(text.strip())
    except ValidationError as error:
        raise typer.BadParameter(f"{text.strip()!r}: {error.errors()[0]['msg']}", param_hint="--exposures") from error


def _refuse_virtual(config: InstrumentConfig) -> None:
    from scanhsi.devices.errors import ConfigError

    real = [device.driver for device in (config.camera, config.actuator) if not device.backend.virtual_time]
    raise ConfigError(
        f"instrument {config.name} cannot run in virtual time: {', '.join(real)} talks to something outside.",
        hint="leave --virtual out, or measure a simulated instrument.",
    )


def _teller() -> Callable[[int, int, Observation], None]:
    console, due = messages(), 0.0

    def tell(number: int, total: int, seen: Observation) -> None:
        nonlocal due
        if time.monotonic() >= due or number == total:
            due = time.monotonic() + _TOLD_EVERY_S
            what = f"{seen.mode}, {seen.scenario}, {seen.pixel_format}, {seen.exposure_s * 1e3:g} ms"
            console.print(f"scan {number}/{total}: {what}", soft_wrap=True)

    return tell


def _described(curve: Curve) -> dict[str, Any]:
    law = curve.law
    return {
        "mode": curve.mode,
        "scenario": curve.scenario,
        "pixel_format": curve.pixel_format,
        "exposure_s": curve.exposure_s.tolist(),
        "period_s": curve.period_s.tolist(),
        "added_s": asdict(law.added),
        "floor_s": None if law.floor is None else asdict(law.floor),
        "r2": law.r2,
        "limit_lines_per_second": law.limit_lps,
        "lines": curve.lines,
        "missing": curve.missing,
    }


@contextmanager
def _quiet(name: str) -> Generator[None]:
    """A sweep connects its devices a dozen times: nobody wants to read that, except when debugging."""
    logger = logging.getLogger(name)
    if logging.getLogger().level > logging.DEBUG:
        logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(logging.NOTSET)

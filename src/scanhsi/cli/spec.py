"""``scanhsi spec``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanhsi.cli.output import messages

if TYPE_CHECKING:
    from scanhsi.characterise.spec_row import Timing


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(spec)


def spec(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT",
            help="Results of `scanhsi calibrate` (*.nc), records of `scanhsi bench lines` (*.jsonl).",
        ),
    ],
    output: Annotated[
        list[Path],
        typer.Option("--output", "-o", metavar="FILE", help="Sheet: .md, .json or .pdf; repeatable."),
    ],
    instrument: Annotated[
        str | None, typer.Option(help="Instrument, for what is set and not measured: limits, steps of a turn.")
    ] = None,
) -> None:
    """Write the specification sheet: Table 7 of the paper, each row from a stored result, "not measured" where there is none.

    [bold]Example[/]: scanhsi spec *.nc bench/observations.jsonl --instrument sensors2019 -o spec.md -o spec.pdf
    """
    from scanhsi.calibration.kinds import load_any
    from scanhsi.characterise.spec import specification
    from scanhsi.characterise.spec_write import write_sheet
    from scanhsi.instrument import load_instrument

    config = None if instrument is None else load_instrument(instrument)
    stored = [(str(path), load_any(path)) for path in results if path.suffix != ".jsonl"]
    timings = [timing for path in results if path.suffix == ".jsonl" for timing in _timings(path)]
    sheet = specification(stored, instrument=config, timings=timings)
    for path in output:
        write_sheet(sheet, path)
        messages().print(str(path), soft_wrap=True)
    if sheet.simulated:
        messages().print("SIMULATED: no instrument was measured.", style="bold yellow")


def _timings(path: Path) -> list[Timing]:
    """Efficiencies of the last session of a bench's records, of whole scans at 100 ms."""
    import math

    from scanhsi.bench.observations import read_sessions
    from scanhsi.bench.scenarios import Scenario
    from scanhsi.characterise.spec_row import Timing

    sessions = read_sessions(path)
    if not sessions:
        return []
    facts = sessions[-1].facts
    found: list[Timing] = []
    for seen in sessions[-1].observations:
        periods = seen.periods_s
        if seen.scenario != Scenario.FULL or len(periods) < 2 or not math.isclose(seen.exposure_s, 0.1):
            continue
        efficiency = seen.exposure_s / float(periods.mean())
        sigma = efficiency * float(periods.std(ddof=1)) / float(periods.mean()) / math.sqrt(len(periods))
        found.append(
            Timing(
                seen.mode,
                seen.pixel_format,
                seen.exposure_s,
                efficiency,
                sigma,
                len(periods),
                str(path),
                str(facts.get("started", "")),
                bool(facts["simulated"]),
            )
        )
    return found

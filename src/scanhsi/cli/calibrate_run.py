"""What all ``scanhsi calibrate`` commands do: take cubes or open those there are, work out, draw, tell."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from scanhsi.cli.output import messages, results, write_json

if TYPE_CHECKING:
    from scanhsi.calibration.applies import Limits
    from scanhsi.calibration.result import Result
    from scanhsi.characterise.station import Target
    from scanhsi.cli.calibrations.work import Work
    from scanhsi.instrument import InstrumentConfig


@dataclass(frozen=True, slots=True)
class Job:
    """One command.

    Attributes:
        instrument: Name or path; None with ``cubes``.
        output: File of the result.
        cubes: Cubes that exist.
        settings: ``key=value`` of the instrument file.
        virtual: In virtual time.
        yes: Do not ask.
        figure: File of the figure; None: beside the result.
        no_figure: Draw none.
        as_json: Print JSON.
        limits: Of age and temperature, for results that are given.
    """

    instrument: str | None
    output: Path
    cubes: list[str] | None
    settings: list[str] | None
    virtual: bool
    yes: bool
    figure: Path | None
    no_figure: bool
    as_json: bool
    limits: Limits


def run_job(job: Job, work: Callable[[], Work]) -> None:
    """Run a command to its end.

    Args:
        job: What all commands are given.
        work: Makes the command's own part; called once the command line is known to be right.
    """
    from scanhsi.calibration.figures import draw
    from scanhsi.calibration.result import save
    from scanhsi.characterise.spec import TABLE_7
    from scanhsi.characterise.spec_rows import result_rows

    if (job.instrument is None) == (job.cubes is None):
        raise typer.BadParameter("give an instrument, or cubes with --from; one of the two.", param_hint="INSTRUMENT")
    if job.cubes is not None:
        result = work().work_out(job.cubes)
        save(result, job.output)
    else:
        result = _take(job, work())
    drawn = None if job.no_figure else draw(result, job.figure or job.output.with_suffix(".png"))
    rows = result_rows(result, str(job.output))
    if job.as_json:
        write_json(
            {
                "output": str(job.output),
                "kind": result.kind,
                "figure": None if drawn is None else str(drawn),
                "simulated": result.provenance.simulated,
                "sources": list(result.provenance.sources),
                "values": [
                    {
                        "name": row.key,
                        "value": row.number,
                        "unit": row.unit,
                        "shown": row.value,
                        "sigma": row.uncertainty,
                    }
                    for row in rows
                ],
            }
        )
        return
    for row in rows:
        title = row.title or TABLE_7[row.key][0]
        sigma = f" (+- {row.uncertainty})" if row.uncertainty else ""
        results().print(f"{title}: {row.value}{sigma}", soft_wrap=True)
    if result.provenance.simulated:
        results().print("SIMULATED: no instrument was measured.", style="bold yellow")
    messages().print(f"{job.output}{'' if drawn is None else f', {drawn}'}", soft_wrap=True)


def _take(job: Job, work: Work) -> Result:
    from scanhsi import clock
    from scanhsi.cli.scan import parsed_settings, refuse_real_devices
    from scanhsi.instrument import load_instrument

    assert job.instrument is not None
    config = load_instrument(job.instrument, parsed_settings(job.settings or ()))
    if job.virtual:
        refuse_real_devices(config)
    return clock.run(_measure(job, work, config), virtual=job.virtual)


async def _measure(job: Job, work: Work, config: InstrumentConfig) -> Result:
    from scanhsi.cli.interrupt import interrupts
    from scanhsi.imager import open_instrument

    console = messages()
    with interrupts(console.print):
        async with open_instrument(config) as imager:
            calibrate = imager.calibrate.asking(_nobody if job.yes else ask, lambda text: console.print(f"  {text}"))
            return await work.take(calibrate.within(job.limits))


async def _nobody(target: Target) -> None:
    del target


async def ask(target: Target) -> None:
    """Ask the person at the terminal to do something, and wait for Enter."""
    _forget_typed()
    messages().print(f"{target.request} Then press Enter.", style="bold")
    await _enter()


def _forget_typed() -> None:
    """What was typed before the question is no answer to it: Enter pressed twice must not pass over the next target."""
    if os.name == "posix" and sys.stdin.isatty():
        import termios

        termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)


async def _enter() -> None:
    """Wait for a line on stdin, so that Ctrl-C gets through; the end of it counts as Enter."""
    loop = asyncio.get_running_loop()
    ready = asyncio.Event()
    try:
        loop.add_reader(sys.stdin.fileno(), ready.set)
    except (OSError, ValueError):  # a file, or none at all: nobody to wait for
        sys.stdin.readline()
        return
    try:
        await ready.wait()
        sys.stdin.readline()
    finally:
        loop.remove_reader(sys.stdin.fileno())

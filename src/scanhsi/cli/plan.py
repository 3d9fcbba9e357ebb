"""``scanhsi plan``."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Annotated

import typer

from scanhsi.cli.output import results, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(plan)


def plan(
    instrument: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped instrument (sensors2019, characterise, twin), or path of an instrument file."
        ),
    ],
    height: Annotated[float, typer.Option(help="Length of the field along the scan, mm.")],
    step: Annotated[int | None, typer.Option(min=1, help="Steps from line to line; default: square pixels.")] = None,
    f_number: Annotated[float | None, typer.Option(help="Of the lens, for the depth of field.")] = None,
    focal: Annotated[float | None, typer.Option(help="Focal length of the lens, mm.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Lines and steps for a field of view, with square pixels; whether it stays even and sharp.

    [bold]Example[/]: scanhsi plan sensors2019 --height 100 --focal 12 --f-number 4
    """
    from scanhsi.characterise.planner import plan_field_of
    from scanhsi.instrument import load_instrument

    found = plan_field_of(load_instrument(instrument), height, step=step, f_number=f_number, focal_mm=focal)
    if json:
        write_json(asdict(found))
        return
    say = results().print
    say(f"--lines {found.lines} --step {found.step} --start {found.start}")
    say(
        f"field {found.width_mm:.1f} x {found.height_mm:.1f} mm, pixels {found.sample_pitch_mm:.3f} x {found.line_pitch_mm:.3f} mm"
    )
    wider = 100 * (found.edge_pitch_mm / found.line_pitch_mm - 1)
    say(f"pixel aspect {found.aspect:.2f}; lines at the ends {wider:.1f} % wider apart")
    far = "" if found.linear else ", beyond the linear range of 22.5 degrees"
    say(f"view {math.degrees(found.view_rad):.1f} degrees to both sides{far}")
    if found.sharp is None:
        say(f"the ends are {found.defocus_mm:.1f} mm farther away")
    else:
        word = "sharp all over" if found.sharp else "NOT sharp all over"
        say(
            f"depth of field {found.depth_of_field_mm:.1f} mm, the ends are {found.defocus_mm:.1f} mm farther away: {word}"
        )

"""``scanhsi quicklook``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanhsi.cli.output import messages, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(quicklook)


def quicklook(
    cube: Annotated[str, typer.Argument(help="Cube to look at: a folder, or a URL of an object store.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="PNG", help="Picture to write; replaced if it exists.")
    ],
    band: Annotated[float, typer.Option(metavar="NM", help="Wavelength of the band picture, in nm.")] = 803.0,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Draw a cube: its colours (CIE 1931) and one band.

    What is brightest is taken for white: keep something white in view for true colours.

    [bold]Example[/]: scanhsi quicklook hand.zarr -o hand.png
    """
    if output.suffix.lower() != ".png":
        raise typer.BadParameter(f"{output} is not a .png file.", param_hint="--output")
    from scanhsi.calibration.picture import save_picture
    from scanhsi.calibration.quicklook import quicklook as look_at

    look = look_at(cube, band_nm=band)
    save_picture(look, output, title=cube.rstrip("/").rpartition("/")[2])
    messages().print(f"{look.colour_note}; beside it {look.band_name}.", soft_wrap=True)
    if json:
        write_json(
            {
                "output": str(output),
                "true_colour": look.true_colour,
                "colour_note": look.colour_note,
                "band": look.band_name,
                "lines": len(look.missing),
                "lines_missing": int(look.missing.sum()),
                "extent_mm": look.extent_mm,
                "simulated": look.simulated,
            }
        )

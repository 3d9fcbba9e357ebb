"""``scanhsi import``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scanhsi.cli.output import messages, results, write_json
from scanhsi.cli.progress import bytes_shown


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="import")(import_)


def import_(
    file: Annotated[
        Path, typer.Argument(help="ENVI header or file of pixels, or NetCDF of OpenHSI or scanhsi export.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="CUBE", help="Cube to write, *.zarr; it must not exist.")
    ],
    calibration: Annotated[
        Path | None, typer.Option(metavar="NC", help="OpenHSI's calibration file, for wavelengths.")
    ] = None,
    dtype: Annotated[
        Literal["uint8", "uint16", "uint32", "float32"] | None,
        typer.Option(help="Of a pixel in the cube; needed for types that no cube holds (int32, float64)."),
    ] = None,
    bits: Annotated[
        int | None, typer.Option(min=1, max=32, help="Significant bits of a pixel, 12 for 12-bit cameras.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Make a cube of an ENVI or NetCDF file. Pickles are refused: loading one runs whatever code is in it.

    [bold]Example[/]: scanhsi import field.hdr -o field.zarr
    """
    from scanhsi.cube.exchange import import_cube

    with bytes_shown(messages(), f"importing {file.name}:") as progress:
        done = import_cube(file, output, calibration=calibration, dtype=dtype, significant_bits=bits, progress=progress)
    if json:
        write_json(
            {
                "output": str(done.path),
                "format": done.format,
                "shape": done.shape,
                "dtype": done.dtype,
                "lines_missing": done.missing,
                "notes": done.notes,
            }
        )
        return
    what = f"{done.shape[0]} bands x {done.shape[1]} lines x {done.shape[2]} samples, {done.dtype}"
    results().print(f"{done.path}: from {done.format}, {what}, {done.missing} lines missing", soft_wrap=True)
    for note in done.notes:
        messages().print(f"note: {note}.", style="yellow", soft_wrap=True)

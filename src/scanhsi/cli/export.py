"""``scanhsi export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scanhsi.cli.output import messages, results, write_json
from scanhsi.cli.progress import bytes_shown


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(export)


def export(
    cube: Annotated[str, typer.Argument(help="Cube to export; partial ones are exported as far as they go.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="File to write; it must not exist. Its ending tells the format: .hdr .bil .bsq .bip .img .raw .dat (ENVI), .nc, "
            ".mat, .ome.tif, .png, .tif (GeoTIFF).",
        ),
    ],
    format: Annotated[
        Literal["envi", "netcdf", "matlab", "ome-tiff", "png", "geotiff"] | None,
        typer.Option(help="Instead of the ending's."),
    ] = None,
    lines: Annotated[
        str | None, typer.Option(metavar="FIRST:END", help="Some lines, the end left out: 10:200, 10:, -100:.")
    ] = None,
    bands: Annotated[
        str | None,
        typer.Option(metavar="BANDS", help="Some bands, by index or wavelength: 803nm; 450nm:700nm; 12,40:50."),
    ] = None,
    interleave: Annotated[Literal["bil", "bsq", "bip"] | None, typer.Option(help="Of ENVI; bil is fastest.")] = None,
    matlab: Annotated[
        Literal["5", "7.3"] | None, typer.Option(help="Version of the MAT-file; by default 5 up to 2 GB, else 7.3.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a cube as a file of another program: ENVI, NetCDF, MATLAB, OME-TIFF, PNG, GeoTIFF.

    [bold]Example[/]: scanhsi export hand.zarr -o hand.bil
    """
    from scanhsi.cube.exchange import export_cube

    with bytes_shown(messages(), f"exporting to {output.name}:") as progress:
        done = export_cube(
            cube,
            output,
            format=format,
            lines=lines,
            bands=bands,
            interleave=interleave,
            matlab=matlab,
            progress=progress,
        )
    if json:
        write_json(
            {
                "outputs": [str(path) for path in done.paths],
                "format": done.format,
                "shape": done.shape,
                "dtype": done.dtype,
                "lines_missing": done.missing,
                "bytes": sum(path.stat().st_size for path in done.paths),
                "notes": done.notes,
            }
        )
        return
    what = f"{done.shape[0]} bands x {done.shape[1]} lines x {done.shape[2]} samples, {done.dtype}"
    results().print(f"{', '.join(str(path) for path in done.paths)}: {done.format}, {what}", soft_wrap=True)
    for note in done.notes:
        messages().print(f"note: {note}.", style="yellow", soft_wrap=True)

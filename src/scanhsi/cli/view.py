"""``scanhsi view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanhsi.cli.output import messages, write_json

if TYPE_CHECKING:
    from scanhsi.calibration.view import View

_ENDINGS = (".png", ".pdf", ".svg")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(view)


def view(
    cube: Annotated[str, typer.Argument(help="Cube to look at: a folder, or a URL of an object store.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Picture, .png, .pdf or .svg.", show_default="CUBE.png, here"
        ),
    ] = None,
    band: Annotated[float, typer.Option(metavar="NM", help="Wavelength of the band picture, in nm.")] = 803.0,
    ratio: Annotated[
        float | None, typer.Option(metavar="NM", help="Show the band over the band at this wavelength.")
    ] = None,
    spectra: Annotated[int, typer.Option(min=0, help="Draw so many spectra of random pixels, and their median.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the random pixels.")] = 0,
    region: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LINES,SAMPLES",
            help='Mean spectrum of a region, "10:30,500:700", or a pixel, "20,600"; repeatable.',
        ),
    ] = None,
    white: Annotated[
        str | None, typer.Option(metavar="LINES,SAMPLES", help="Region that is white, for the colours of raw counts.")
    ] = None,
    illuminant: Annotated[
        str, typer.Option(help='Light of the colours: D65, D50, A, E, FL11, ..., "3200 K", or a CSV file.')
    ] = "D65",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, with the regions' spectra.")] = False,
) -> None:
    """Draw a cube: its colours (CIE 1931), one band or the ratio of two, spectra (figure 14 of the paper).

    Reflectance has true colours. In a raw cube what is brightest is taken for white: keep something white in view, or name it with
    --white. Interrupted cubes and cubes of a running scan are drawn as far as they go.

    [bold]Example[/]: scanhsi view hand.zarr -o hand.png --region 200:220,500:540
    """
    name = cube.rstrip("/").rpartition("/")[2]
    target = output or Path(f"{name.removesuffix('.zarr')}.png")
    if target.suffix.lower() not in _ENDINGS:
        raise typer.BadParameter(f"{target} is no {', '.join(_ENDINGS)} file.", param_hint="--output")
    from scanhsi.calibration.figures.view import save_view
    from scanhsi.calibration.view import view as look_at

    look = look_at(
        cube,
        band_nm=band,
        ratio_nm=ratio,
        white=None if white is None else _region(white, "--white"),
        light=illuminant,
        spectra=spectra,
        seed=seed,
        regions=[_region(text, "--region") for text in region or ()],
    )
    save_view(look, target, title=name)
    if json:
        write_json({"output": str(target), **_told(look)})
    messages().print(f"{target}: {look.colour_note}; beside it {look.band_name}.", soft_wrap=True)


def _region(text: str, option: str) -> tuple[slice, slice]:
    """``"10:30,500:700"``: lines and samples, the ends not included; one number is one line or sample, nothing is all."""
    try:
        lines, samples = (_span(part.strip()) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f'{text!r} is no region; write "10:30,500:700".', param_hint=option) from None
    return lines, samples


def _span(text: str) -> slice:
    first, colon, end = text.partition(":")
    if not colon:
        return slice(int(first), int(first) + 1)
    span = slice(int(first) if first else None, int(end) if end else None)
    if min(span.start or 0, span.stop or 0) < 0:
        raise ValueError
    return span


def _told(look: View) -> dict[str, Any]:
    return {
        "true_colour": look.true_colour,
        "colour_note": look.colour_note,
        "out_of_gamut": look.out_of_gamut,
        "band": look.band_name,
        "quantity": look.quantity,
        "lines": len(look.missing),
        "lines_missing": int(look.missing.sum()),
        "extent_mm": look.extent_mm,
        "simulated": look.provenance.simulated is True,
        "wavelength_nm": None if look.wavelength_nm is None else look.wavelength_nm.tolist(),
        "regions": [
            {
                "lines": list(region.lines),
                "samples": list(region.samples),
                "mean": _numbers(region.mean.tolist()),
                "sigma": _numbers(region.sigma.tolist()),
                "count": region.count.tolist(),
            }
            for region in look.regions
        ],
    }


def _numbers(values: list[float]) -> list[float | None]:
    """JSON knows no nan."""
    return [value if value == value else None for value in values]

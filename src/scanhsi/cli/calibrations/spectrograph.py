"""Wavelengths, smile and keystone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanhsi.cli.calibrations.work import Dark, Degree, Exposure, Frames, Given, Lines, Work
from scanhsi.cli.quantities import seconds_of

if TYPE_CHECKING:
    from scanhsi.calibration.lines import LineList


def wavelength(
    given: Given,
    dark: Dark = None,
    lines: Lines = None,
    degree: Degree = 2,
    exposure: Exposure = None,
    frames: Frames = 20,
) -> Work:
    """Wavelengths of the bands, from a spectral lamp (Eq. 14, figures 9 and 10).

    [bold]Example[/]: scanhsi calibrate wavelength characterise -o wavelength.nc
    """
    from scanhsi.characterise.lamp_from_cubes import wavelength_from_cubes

    model, known, time = given.dark(dark), _lines(lines), seconds_of(exposure, "--exposure")
    return Work(
        lambda hsi: hsi.wavelength(
            given.output, dark=model, lines=known, exposure_s=time, frames=frames, degree=degree
        ),
        lambda cubes: wavelength_from_cubes(cubes, dark=model, lines=known, degree=degree),
    )


def wavelength_tile(
    given: Given,
    certificate: Annotated[
        Path, typer.Option(help="CSV of the tile's minima: a column wavelength_nm.", dir_okay=False)
    ],
    dark: Dark = None,
    degree: Degree = 2,
    width: Annotated[float, typer.Option(help="Of the narrow minima, bands, roughly.")] = 16.0,
    exposure: Exposure = None,
    frames: Frames = 20,
) -> Work:
    """Wavelengths of the bands, from a tile with absorption bands (figure 9).

    [bold]Example[/]: scanhsi calibrate wavelength-tile characterise --certificate tile.csv -o wavelength.nc
    """
    from scanhsi.calibration.lines import load_lines
    from scanhsi.characterise.lamp_from_cubes import tile_from_cubes

    model, known, time = given.dark(dark), load_lines(certificate), seconds_of(exposure, "--exposure")
    return Work(
        lambda hsi: hsi.wavelength_tile(
            known,
            given.output,
            dark=model,
            exposure_s=time,
            frames=frames,
            degree=degree,
            width_bands=width,
        ),
        lambda cubes: tile_from_cubes(cubes, known, dark=model, degree=degree, width_bands=width),
    )


def smile(
    given: Given,
    dark: Dark = None,
    lines: Lines = None,
    degree: Degree = 2,
    exposure: Exposure = None,
    frames: Frames = 20,
) -> Work:
    """Smile, from a spectral lamp that lights all of the slit (figure 9); --from the wavelength's cubes will do.

    [bold]Example[/]: scanhsi calibrate smile characterise -o smile.nc
    """
    from scanhsi.characterise.lamp_from_cubes import smile_from_cubes

    model, known, time = given.dark(dark), _lines(lines), seconds_of(exposure, "--exposure")
    return Work(
        lambda hsi: hsi.smile(given.output, dark=model, lines=known, exposure_s=time, frames=frames, degree=degree),
        lambda cubes: smile_from_cubes(cubes, dark=model, lines=known, degree=degree),
    )


def keystone(given: Given, dark: Dark = None, exposure: Exposure = None, frames: Frames = 20) -> Work:
    """Keystone, from the slanted lines with the mirror at rest, and a white tile.

    [bold]Example[/]: scanhsi calibrate keystone characterise -o keystone.nc
    """
    from scanhsi.characterise.lamp_from_cubes import keystone_from_cubes

    model, time = given.dark(dark), seconds_of(exposure, "--exposure")
    return Work(
        lambda hsi: hsi.keystone(given.output, dark=model, exposure_s=time, frames=frames),
        lambda cubes: keystone_from_cubes(cubes, dark=model),
    )


def _lines(path: Path | None) -> LineList | None:
    if path is None:
        return None
    from scanhsi.calibration.lines import load_lines

    return load_lines(path)

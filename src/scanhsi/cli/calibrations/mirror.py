"""The mirror's drive."""

from __future__ import annotations

from typing import Annotated

import typer

from scanhsi.cli.calibrations.work import Exposure, Given, Half, Plane, Slant, Work, only, turn_of
from scanhsi.cli.quantities import seconds_of


def jitter(
    given: Given,
    plane: Plane = None,
    slant: Slant = 10.0,
    turn: Annotated[
        str | None,
        typer.Option(
            metavar="STEPS|find",
            help="Steps of a turn of the shaft that is out of true; default: as --plane has it, else found.",
        ),
    ] = None,
    half: Half = 64.0,
    exposure: Exposure = None,
) -> Work:
    """Jitter of the mirror, line by line, from slanted lines (figure 8).

    [bold]Example[/]: scanhsi calibrate jitter characterise --plane geometry.nc -o jitter.nc
    """
    from scanhsi.characterise.mirror_from_cubes import jitter_from_cube

    known, time, shaft = given.plane(plane), seconds_of(exposure, "--exposure"), turn_of(turn)
    return Work(
        lambda hsi: hsi.jitter(given.output, plane=known, half_mm=half, slant_deg=slant, turn=shaft, exposure_s=time),
        lambda cubes: jitter_from_cube(
            only(cubes, "a cube of the slanted lines"), slant_deg=slant, plane=known, turn=shaft
        ),
    )


def backlash(
    given: Given,
    plane: Plane = None,
    half: Half = 50.0,
    runs: Annotated[int, typer.Option(min=1, help="Scans in either direction.")] = 3,
    exposure: Exposure = None,
) -> Work:
    """Backlash of the mirror's drive: slanted lines, scanned upwards and downwards.

    [bold]Example[/]: scanhsi calibrate backlash characterise --plane geometry.nc -o backlash.nc
    """
    from scanhsi.characterise.mirror_from_cubes import backlash_from_cubes

    known, time = given.plane(plane), seconds_of(exposure, "--exposure")
    return Work(
        lambda hsi: hsi.backlash(given.output, plane=known, half_mm=half, runs=runs, exposure_s=time),
        lambda cubes: backlash_from_cubes(cubes, plane=known),
    )


def repeatability(
    given: Given,
    plane: Plane = None,
    slant: Slant = 10.0,
    half: Half = 50.0,
    positions: Annotated[int, typer.Option(min=5, help="Positions that are approached.")] = 11,
    runs: Annotated[int, typer.Option(min=3, help="Approaches to each from either side.")] = 5,
    exposure: Exposure = None,
) -> Work:
    """Repeatability of the mirror in the style of ISO 230-2: positions approached from both sides, again and again.

    [bold]Example[/]: scanhsi calibrate repeatability characterise --plane geometry.nc -o repeatability.nc
    """
    from scanhsi.characterise.mirror_from_cubes import repeatability_from_cubes

    known, time = given.plane(plane), seconds_of(exposure, "--exposure")
    return Work(
        lambda hsi: hsi.repeatability(
            given.output,
            plane=known,
            half_mm=half,
            positions=positions,
            runs=runs,
            slant_deg=slant,
            exposure_s=time,
        ),
        lambda cubes: repeatability_from_cubes(cubes, slant_deg=slant, plane=known),
    )

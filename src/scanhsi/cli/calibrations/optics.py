"""Object plane and sharpness."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from scanhsi.cli.calibrations.work import Exposure, Given, Half, Plane, Work, only, turn_of
from scanhsi.cli.quantities import seconds_of

if TYPE_CHECKING:
    from scanhsi.calibration.result import Result


def geometry(
    given: Given,
    pitch: Annotated[float, typer.Option(help="Of the grid, mm.")] = 6.0,
    half: Half = 64.0,
    tilt: Annotated[bool, typer.Option("--tilt", help="Fit the tilt of the plane, too.")] = False,
    origin_unknown: Annotated[
        bool, typer.Option("--origin-unknown", help="No line of the grid lies at the foot of the normal.")
    ] = False,
    turn: Annotated[
        str | None,
        typer.Option(metavar="STEPS|find", help="Fit a shaft out of true, too, whose turn has so many steps."),
    ] = None,
    exposure: Exposure = None,
) -> Work:
    """Distance, normal step and sample pitch, from a grid (figure 7).

    [bold]Example[/]: scanhsi calibrate geometry characterise -o geometry.nc
    """
    from scanhsi.characterise.targets_from_cubes import geometry_from_cube

    time, shaft = seconds_of(exposure, "--exposure"), turn_of(turn)
    return Work(
        lambda hsi: hsi.geometry(
            given.output,
            pitch_mm=pitch,
            half_mm=half,
            exposure_s=time,
            fit_tilt=tilt,
            origin_known=not origin_unknown,
            turn=shaft,
        ),
        lambda cubes: geometry_from_cube(
            only(cubes, "a cube of the grid"),
            pitch_mm=pitch,
            fit_tilt=tilt,
            origin_known=not origin_unknown,
            turn=shaft,
        ),
    )


def resolution(
    given: Given,
    axis: Annotated[Literal["line", "sample"], typer.Option(help="Along the scan, or along the slit.")] = "line",
    bars: Annotated[
        Path | None,
        typer.Option(help="With --from a cube of a USAF target: CSV that says where its bars are.", dir_okay=False),
    ] = None,
    usaf: Annotated[
        bool, typer.Option("--usaf", help="With --from a cube of a USAF target, its groups in columns: find the bars.")
    ] = False,
    scans: Annotated[int | None, typer.Option(min=1, help="To average. Default: six along the scan, else one.")] = None,
    plane: Plane = None,
    half: Half = 30.0,
    exposure: Exposure = None,
) -> Work:
    """Modulation transfer across a slanted edge; or contrast of the bars of a USAF target (figure 11).

    [bold]Example[/]: scanhsi calibrate resolution characterise --axis line --plane geometry.nc -o mtf-line.nc
    """
    from scanhsi.characterise.bars_from_cube import bars_from_cube, load_bars
    from scanhsi.characterise.targets_from_cubes import edge_from_cubes

    known, time = given.plane(plane), seconds_of(exposure, "--exposure")
    if (usaf or bars is not None) and given.cubes is None:
        raise typer.BadParameter("scan the target, and give its cube with --from.", param_hint="--usaf, --bars")

    def work_out(cubes: list[str]) -> Result:
        if usaf or bars is not None:
            where = None if bars is None else load_bars(bars)
            return bars_from_cube(only(cubes, "a cube of the target"), axis, where, plane=known)
        return edge_from_cubes(cubes, axis, plane=known)

    return Work(
        lambda hsi: hsi.resolution(given.output, axis=axis, plane=known, half_mm=half, scans=scans, exposure_s=time),
        work_out,
    )

"""``scanhsi calibrate``."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from scanhsi.cli.calibrate_run import Job, run_job
from scanhsi.cli.quantities import seconds_list, seconds_of

if TYPE_CHECKING:
    from scanhsi.calibration.dark import DarkModel
    from scanhsi.calibration.geometry import Geometry
    from scanhsi.calibration.result import Result
    from scanhsi.characterise.calibrator import Calibrator

Instrument = Annotated[
    str | None,
    typer.Argument(help="Name of a shipped instrument, or path of an instrument file; not with --from."),
]
Output = Annotated[
    Path, typer.Option("--output", "-o", metavar="FILE", help="Result, a NetCDF-4 file, conventionally *.nc.")
]
From = Annotated[
    list[str] | None,
    typer.Option("--from", metavar="CUBE", help="Use cubes that exist, not the instrument; repeatable."),
]
Dark = Annotated[Path | None, typer.Option("--dark", help="Dark model of `scanhsi calibrate dark`.")]
Plane = Annotated[Path | None, typer.Option(help="Geometry as measured; default: as the instrument file has it.")]
Figure = Annotated[Path | None, typer.Option(metavar="FILE", help="Figure, .png or .pdf. [default: beside the result]")]
NoFigure = Annotated[bool, typer.Option("--no-figure", help="Draw none.")]
Virtual = Annotated[bool, typer.Option("--virtual", help="Simulated instruments: in virtual time.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the instrument file; repeatable."),
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask: everything is where it should be.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Frames = Annotated[int, typer.Option(min=2, help="Frames at each exposure.")]
Tile = Annotated[float, typer.Option(help="Reflectance of the white tile.")]
Exposure = Annotated[str | None, typer.Option(metavar="TIME", help='As "20 ms"; default: found automatically.')]
Exposures = Annotated[str | None, typer.Option(metavar="TIMES", help='As "10 ms, 100 ms".')]

Take = Callable[["Calibrator"], Awaitable["Result"]]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    group = typer.Typer(no_args_is_help=True, help="Characterise an instrument: take, work out, draw and keep.")
    for name, command in (
        ("dark", dark),
        ("white", white),
        ("photon-transfer", photon_transfer),
        ("snr", snr),
        ("light", light),
        ("wavelength", wavelength),
        ("geometry", geometry),
        ("jitter", jitter),
        ("resolution", resolution),
    ):
        group.command(name)(command)
    app.add_typer(group, name="calibrate")


def dark(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    exposures: Exposures = None,
    frames: Frames = 20,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Dark signal of every pixel over the exposure (Eq. 15), hot pixels.

    [bold]Example[/]: scanhsi calibrate dark sensors2019 -o dark.nc
    """
    times = seconds_list(exposures, "--exposures")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.dark(output, exposures_s=times, frames=frames)

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.from_cubes import dark_from_cubes

        return dark_from_cubes(found)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def white(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    dark_model: Dark = None,
    exposure: Exposure = None,
    tile: Tile = 0.99,
    frames: Frames = 20,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """White reference of a tile; the exposure is found by itself.

    [bold]Example[/]: scanhsi calibrate white sensors2019 --dark dark.nc -o white.nc
    """
    model = _dark_model(dark_model)
    time = seconds_of(exposure, "--exposure")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.white(output, dark=model, exposure_s=time, frames=frames, tile=tile)

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.from_cubes import split_by_target, white_from_cubes

        if model is not None:
            return white_from_cubes(_only(found, "a cube of the tile"), model, tile=tile)
        below, above = split_by_target(found)
        return white_from_cubes(_only(above, "a cube of the tile"), _only(below, "a dark cube"), tile=tile)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def photon_transfer(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    exposures: Exposures = None,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Gain, noise, full well and linearity of the sensor (a subset of EMVA 1288).

    [bold]Example[/]: scanhsi calibrate photon-transfer sensors2019 -o ptc.nc
    """
    times = seconds_list(exposures, "--exposures")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.photon_transfer(output, exposures_s=times)

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.noise_from_cubes import photon_transfer_from_cubes

        return photon_transfer_from_cubes(found)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def snr(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    dark_model: Dark = None,
    exposures: Exposures = None,
    tile: Tile = 0.99,
    frames: Frames = 20,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Signal to noise by band and exposure, the paper's (Eq. 20) and the usual one (figure 12, left).

    [bold]Example[/]: scanhsi calibrate snr sensors2019 --dark dark.nc -o snr.nc
    """
    model = _dark_model(dark_model)
    times = seconds_list(exposures, "--exposures")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.snr(output, dark=model, exposures_s=times, frames=frames, tile=tile)

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.noise_from_cubes import snr_from_cubes

        return snr_from_cubes(found, dark=model, tile=tile)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def light(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    dark_model: Dark = None,
    exposure: Exposure = None,
    snapshots: Annotated[int, typer.Option(min=8, help="How many.")] = 20,
    interval: Annotated[str, typer.Option(metavar="TIME", help="From one to the next.")] = "40 s",
    on_before: Annotated[str, typer.Option(metavar="TIME", help="How long the lamp has been on.")] = "0 s",
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """How the lamp settles, drifts and flickers (figure 12, right): switch it on and start this at once.

    [bold]Example[/]: scanhsi calibrate light sensors2019 --virtual -o light.nc
    """
    model = _dark_model(dark_model)
    time, every = seconds_of(exposure, "--exposure"), seconds_of(interval, "--interval")
    before = seconds_of(on_before, "--on-before")
    assert every is not None
    assert before is not None

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.light(
            output, dark=model, exposure_s=time, snapshots=snapshots, interval_s=every, on_before_s=before
        )

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.noise_from_cubes import light_from_cubes

        return light_from_cubes(found, dark=model, on_before_s=before)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def wavelength(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    dark_model: Dark = None,
    lines: Annotated[
        Path | None, typer.Option(help="CSV of the lamp's lines; default: mercury-argon.", dir_okay=False)
    ] = None,
    degree: Annotated[int, typer.Option(min=1, help="Of the polynomial.")] = 2,
    exposure: Exposure = None,
    frames: Frames = 20,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Wavelengths of the bands, from a spectral lamp (Eq. 14, figures 9 and 10).

    [bold]Example[/]: scanhsi calibrate wavelength characterise -o wavelength.nc
    """
    from scanhsi.calibration.lines import load_lines

    model = _dark_model(dark_model)
    known = None if lines is None else load_lines(lines)
    time = seconds_of(exposure, "--exposure")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.wavelength(
            output, dark=model, lines=known, exposure_s=time, frames=frames, degree=degree
        )

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.lamp_from_cubes import wavelength_from_cubes

        return wavelength_from_cubes(found, dark=model, lines=known, degree=degree)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def geometry(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    pitch: Annotated[float, typer.Option(help="Of the grid, mm.")] = 6.0,
    half: Annotated[float, typer.Option(help="How far the scan goes to both sides, mm.")] = 64.0,
    tilt: Annotated[bool, typer.Option("--tilt", help="Fit the tilt of the plane, too.")] = False,
    origin_unknown: Annotated[
        bool, typer.Option("--origin-unknown", help="No line of the grid lies at the foot of the normal.")
    ] = False,
    exposure: Exposure = None,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Distance, normal step and sample pitch, from a grid (figure 7).

    [bold]Example[/]: scanhsi calibrate geometry characterise -o geometry.nc
    """
    time = seconds_of(exposure, "--exposure")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.geometry(
            output, pitch_mm=pitch, half_mm=half, exposure_s=time, fit_tilt=tilt, origin_known=not origin_unknown
        )

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.targets_from_cubes import geometry_from_cube

        return geometry_from_cube(
            _only(found, "a cube of the grid"), pitch_mm=pitch, fit_tilt=tilt, origin_known=not origin_unknown
        )

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def jitter(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    plane: Plane = None,
    slant: Annotated[float, typer.Option(help="Of the lines from the slit, degrees.")] = 10.0,
    turn: Annotated[
        float | None, typer.Option(help="Steps of a turn of the shaft that may be out of true; default: of the mirror.")
    ] = None,
    half: Annotated[float, typer.Option(help="How far the scan goes to both sides, mm.")] = 50.0,
    exposure: Exposure = None,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Jitter of the mirror, line by line, from slanted lines (figure 8).

    [bold]Example[/]: scanhsi calibrate jitter characterise --plane geometry.nc -o jitter.nc
    """
    known = _plane(plane)
    time = seconds_of(exposure, "--exposure")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.jitter(
            output, plane=known, half_mm=half, slant_deg=slant, turn_steps=turn, exposure_s=time
        )

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.targets_from_cubes import jitter_from_cube

        return jitter_from_cube(
            _only(found, "a cube of the slanted lines"), slant_deg=slant, plane=known, turn_steps=turn
        )

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def resolution(
    output: Output,
    instrument: Instrument = None,
    cubes: From = None,
    axis: Annotated[Literal["line", "sample"], typer.Option(help="Along the scan, or along the slit.")] = "line",
    bars: Annotated[
        Path | None,
        typer.Option(help="With --from a cube of a USAF target: CSV that says where its bars are.", dir_okay=False),
    ] = None,
    plane: Plane = None,
    half: Annotated[float, typer.Option(help="How far the scan goes to both sides, mm.")] = 30.0,
    exposure: Exposure = None,
    figure: Figure = None,
    no_figure: NoFigure = False,
    virtual: Virtual = False,
    settings: Set = None,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Modulation transfer across a slanted edge; or contrast of the bars of a USAF target (figure 11).

    [bold]Example[/]: scanhsi calibrate resolution characterise --axis line --plane geometry.nc -o mtf-line.nc
    """
    known = _plane(plane)
    time = seconds_of(exposure, "--exposure")

    if bars is not None and cubes is None:
        raise typer.BadParameter("look at the cube first, to say where the bars are: use --from.", param_hint="--bars")

    async def take(calibrate: Calibrator) -> Result:
        return await calibrate.resolution(output, axis=axis, plane=known, half_mm=half, exposure_s=time)

    def work_out(found: list[str]) -> Result:
        from scanhsi.characterise.bars_from_cube import bars_from_cube, load_bars
        from scanhsi.characterise.targets_from_cubes import edge_from_cube

        if bars is not None:
            return bars_from_cube(_only(found, "a cube of the target"), axis, load_bars(bars), plane=known)
        return edge_from_cube(_only(found, "a cube of the edge"), axis, plane=known)

    run_job(Job(instrument, output, cubes, take, work_out, settings, virtual, yes, figure, no_figure, json))


def _plane(path: Path | None) -> Geometry | None:
    if path is None:
        return None
    from scanhsi.calibration.geometry import Geometry
    from scanhsi.calibration.result import load

    return load(Geometry, path)


def _dark_model(path: Path | None) -> DarkModel | None:
    if path is None:
        return None
    from scanhsi.calibration.dark import DarkModel
    from scanhsi.calibration.result import load

    return load(DarkModel, path)


def _only(cubes: list[Any], what: str) -> Any:
    if len(cubes) != 1:
        raise typer.BadParameter(f"{what} is needed, one; there are {len(cubes)}.", param_hint="--from")
    return cubes[0]

"""Sensor and light."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from scanhsi.cli.calibrations.work import Dark, Exposure, Exposures, Frames, Given, Tile, Work, only
from scanhsi.cli.quantities import seconds_list, seconds_of

if TYPE_CHECKING:
    from scanhsi.calibration.result import Result


def dark(given: Given, exposures: Exposures = None, frames: Frames = 20) -> Work:
    """Dark signal of every pixel over the exposure (Eq. 15), hot pixels.

    [bold]Example[/]: scanhsi calibrate dark sensors2019 -o dark.nc
    """
    from scanhsi.characterise.from_cubes import dark_from_cubes

    times = seconds_list(exposures, "--exposures")
    return Work(lambda hsi: hsi.dark(given.output, exposures_s=times, frames=frames), dark_from_cubes)


def white(given: Given, dark: Dark = None, exposure: Exposure = None, tile: Tile = 0.99, frames: Frames = 20) -> Work:
    """White reference of a tile; the exposure is found by itself.

    [bold]Example[/]: scanhsi calibrate white sensors2019 --dark dark.nc -o white.nc
    """
    from scanhsi.characterise.from_cubes import split_by_target, white_from_cubes

    model, time = given.dark(dark), seconds_of(exposure, "--exposure")

    def work_out(cubes: list[str]) -> Result:
        if model is not None:
            return white_from_cubes(only(cubes, "a cube of the tile"), model, tile=tile)
        below, above = split_by_target(cubes)
        return white_from_cubes(only(above, "a cube of the tile"), only(below, "a dark cube"), tile=tile)

    return Work(lambda hsi: hsi.white(given.output, dark=model, exposure_s=time, frames=frames, tile=tile), work_out)


def photon_transfer(given: Given, exposures: Exposures = None) -> Work:
    """Gain, noise, full well and linearity of the sensor (a subset of EMVA 1288).

    [bold]Example[/]: scanhsi calibrate photon-transfer sensors2019 -o ptc.nc
    """
    from scanhsi.characterise.noise_from_cubes import photon_transfer_from_cubes

    times = seconds_list(exposures, "--exposures")
    return Work(lambda hsi: hsi.photon_transfer(given.output, exposures_s=times), photon_transfer_from_cubes)


def snr(given: Given, dark: Dark = None, exposures: Exposures = None, tile: Tile = 0.99, frames: Frames = 20) -> Work:
    """Signal to noise by band and exposure, the paper's (Eq. 20) and the usual one (figure 12, left).

    [bold]Example[/]: scanhsi calibrate snr sensors2019 --dark dark.nc -o snr.nc
    """
    from scanhsi.characterise.noise_from_cubes import snr_from_cubes

    model, times = given.dark(dark), seconds_list(exposures, "--exposures")
    return Work(
        lambda hsi: hsi.snr(given.output, dark=model, exposures_s=times, frames=frames, tile=tile),
        lambda cubes: snr_from_cubes(cubes, dark=model, tile=tile),
    )


def light(
    given: Given,
    dark: Dark = None,
    exposure: Exposure = None,
    snapshots: Annotated[int, typer.Option(min=8, help="How many.")] = 20,
    interval: Annotated[str, typer.Option(metavar="TIME", help="From one to the next.")] = "40 s",
    on_before: Annotated[str, typer.Option(metavar="TIME", help="How long the lamp has been on.")] = "0 s",
) -> Work:
    """How the lamp settles, drifts and flickers (figure 12, right): switch it on and start this at once.

    [bold]Example[/]: scanhsi calibrate light sensors2019 --virtual -o light.nc
    """
    from scanhsi.characterise.noise_from_cubes import light_from_cubes

    model, time = given.dark(dark), seconds_of(exposure, "--exposure")
    every, before = seconds_of(interval, "--interval") or 0.0, seconds_of(on_before, "--on-before") or 0.0
    return Work(
        lambda hsi: hsi.light(
            given.output, dark=model, exposure_s=time, snapshots=snapshots, interval_s=every, on_before_s=before
        ),
        lambda cubes: light_from_cubes(cubes, dark=model, on_before_s=before),
    )

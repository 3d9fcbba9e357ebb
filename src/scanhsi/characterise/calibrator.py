"""``hsi.calibrate``: takes what a calibration needs, works it out, keeps the result and the cubes it came from."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, TypeVar

import numpy as np

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.resolution import EdgeResponse
from scanhsi.calibration.result import Result, save
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.calibration.white import WhiteReference
from scanhsi.characterise.aids import auto_exposure
from scanhsi.characterise.from_cubes import dark_from_cubes, white_from_cubes
from scanhsi.characterise.lamp_from_cubes import wavelength_from_cubes
from scanhsi.characterise.noise_from_cubes import light_from_cubes, photon_transfer_from_cubes, snr_from_cubes
from scanhsi.characterise.station import (
    DARK,
    GRID,
    LAMP,
    SLANTED_EDGE,
    SLANTED_LINES,
    WHITE,
    Prompt,
    Scans,
    Station,
    Target,
    Tell,
    station,
)
from scanhsi.characterise.targets_from_cubes import edge_from_cube, geometry_from_cube, jitter_from_cube
from scanhsi.clock import now_ns, run_blocking, sleep_until_ns

R = TypeVar("R", bound=Result)

_DARK_EXPOSURES: Final = 8
_LONGEST_DARK_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class Calibrator:
    """Protocols of an open instrument.

    Every method takes the cubes it needs and returns the result. With ``output`` the result is saved there (NetCDF-4) and the
    cubes are kept beside it, in ``<name>-cubes``, which must not exist; without, they are thrown away. All may be cancelled at any
    time: the mirror is stopped, what was taken whole stays a valid cube, and no result is written.

    Attributes:
        imager: The instrument.
        prompt: Asks a person to put something before it. Simulated instruments are shown their scenes without asking.
        tell: Told what is being done.
    """

    imager: Scans
    prompt: Prompt | None = None
    tell: Tell | None = None

    def asking(self, prompt: Prompt | None, tell: Tell | None = None) -> Calibrator:
        """The same with somebody to ask, and to tell."""
        return replace(self, prompt=prompt, tell=tell)

    async def dark(
        self, output: str | Path | None = None, *, exposures_s: Sequence[float] | None = None, frames: int = 20
    ) -> DarkModel:
        """Dark signal of every pixel over the exposure (Eq. 15).

        Args:
            output: File of the result.
            exposures_s: Default: eight from the shortest to the longest that the instrument allows, 2 s at most.
            frames: At each exposure.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        exposures = list(self._dark_exposures() if exposures_s is None else exposures_s)
        async with self._station(output) as at:
            await at.look_at(DARK)
            cubes = [
                await at.still(f"dark-{number}", DARK, exposure_s=exposure, frames=frames)
                for number, exposure in enumerate(exposures)
            ]
            return await _finish(output, lambda: dark_from_cubes(cubes))

    async def white(
        self,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        exposure_s: float | None = None,
        frames: int = 20,
        tile: float = 0.99,
    ) -> WhiteReference:
        """White reference of a tile.

        Args:
            output: File of the result.
            dark: Dark model; None takes a dark cube of the same exposure as well.
            exposure_s: Of the tile; None finds one with `auto_exposure`.
            frames: To average.
            tile: Reflectance of the tile.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            await at.look_at(WHITE)
            if exposure_s is None:
                exposure_s = (await auto_exposure(self.imager)).exposure_s
            white = await at.still("white", WHITE, exposure_s=exposure_s, frames=frames)
            below: DarkModel | Path
            if dark is not None:
                below = dark
            else:
                await at.look_at(DARK)
                below = await at.still("dark", DARK, exposure_s=exposure_s, frames=frames)
            return await _finish(output, lambda: white_from_cubes(white, below, tile=tile))

    async def photon_transfer(
        self, output: str | Path | None = None, *, exposures_s: Sequence[float] | None = None
    ) -> PhotonTransfer:
        """Photon transfer of the sensor (EMVA 1288): gain, noise, full well, from flat and dark pairs of frames.

        Args:
            output: File of the result.
            exposures_s: Default: eighteen from the shortest to 1.2 times that which saturates the white tile.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            await at.look_at(WHITE)
            exposures = list(exposures_s) if exposures_s is not None else await self._up_to_saturation()
            cubes = [await at.still(f"flat-{n}", WHITE, exposure_s=t, frames=2) for n, t in enumerate(exposures)]
            await at.look_at(DARK)
            cubes += [await at.still(f"dark-{n}", DARK, exposure_s=t, frames=2) for n, t in enumerate(exposures)]
            return await _finish(output, lambda: photon_transfer_from_cubes(cubes))

    async def snr(
        self,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        exposures_s: Sequence[float] | None = None,
        frames: int = 20,
        tile: float = 0.99,
    ) -> SignalToNoise:
        """Signal to noise of a white tile by band and exposure (Eqs. 16-20, figure 12 left).

        Args:
            output: File of the result.
            dark: Dark model; None takes dark cubes as well.
            exposures_s: Default: five up to that of `auto_exposure`.
            frames: At each exposure.
            tile: Reflectance of the tile.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            await at.look_at(WHITE)
            exposures = list(exposures_s) if exposures_s is not None else await self._up_to_white()
            cubes = [await at.still(f"white-{n}", WHITE, exposure_s=t, frames=frames) for n, t in enumerate(exposures)]
            if dark is None:
                await at.look_at(DARK)
                cubes += [
                    await at.still(f"dark-{n}", DARK, exposure_s=t, frames=frames) for n, t in enumerate(exposures)
                ]
            return await _finish(output, lambda: snr_from_cubes(cubes, dark=dark, tile=tile))

    async def light(
        self,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        exposure_s: float | None = None,
        snapshots: int = 20,
        interval_s: float = 40.0,
        frames: int = 4,
        on_before_s: float = 0.0,
    ) -> LightStability:
        """Stability of the lamp (figure 12 right): switch it on, start this, let it run.

        Args:
            output: File of the result.
            dark: Dark model; None takes a dark cube in the end.
            exposure_s: Default: half of that of `auto_exposure`, since a lamp may become brighter.
            snapshots: How many; the paper took 20.
            interval_s: From one to the next.
            frames: Of each snapshot.
            on_before_s: How long the lamp was on before.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            await at.look_at(WHITE)
            began_ns = now_ns()
            exposure = exposure_s or (await auto_exposure(self.imager)).exposure_s / 2
            exposure = max(exposure, self.imager.instrument.camera_info.exposure.minimum)
            on_before_s += (now_ns() - began_ns) * 1e-9
            first_ns = now_ns()
            cubes: list[Path] = []
            for number in range(snapshots):
                await sleep_until_ns(first_ns + round(number * interval_s * 1e9))
                cubes.append(await at.still(f"light-{number:03}", WHITE, exposure_s=exposure, frames=frames))
            if dark is None:
                await at.look_at(DARK)
                cubes.append(await at.still("dark", DARK, exposure_s=exposure, frames=4 * frames))
            return await _finish(output, lambda: light_from_cubes(cubes, dark=dark, on_before_s=on_before_s))

    async def geometry(
        self,
        output: str | Path | None = None,
        *,
        pitch_mm: float = 6.0,
        half_mm: float = 64.0,
        exposure_s: float | None = None,
        fit_tilt: bool = False,
        origin_known: bool = True,
    ) -> Geometry:
        """Distance, normal step and sample pitch, from a grid (figure 7).

        Args:
            output: File of the result.
            pitch_mm: Of the grid.
            half_mm: How far the scan goes to both sides.
            exposure_s: Default: found by `auto_exposure` on the grid.
            fit_tilt: Fit the tilt of the plane, too.
            origin_known: A line of the grid lies at the foot of the normal.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            cube = await self._target(at, GRID, half_mm, exposure_s)
            return await _finish(
                output,
                lambda: geometry_from_cube(cube, pitch_mm=pitch_mm, fit_tilt=fit_tilt, origin_known=origin_known),
            )

    async def jitter(
        self,
        output: str | Path | None = None,
        *,
        plane: Geometry | None = None,
        half_mm: float = 50.0,
        slant_deg: float = 10.0,
        turn_steps: float | None = None,
        harmonics: int = 2,
        exposure_s: float | None = None,
    ) -> Jitter:
        """Jitter of the mirror, line by line, from slanted lines (figure 8).

        Args:
            output: File of the result.
            plane: Geometry as measured; the instrument file's by default.
            half_mm: How far the scan goes to both sides.
            slant_deg: Of the target's lines from the slit.
            turn_steps: Steps of a turn of the shaft that may be out of true; of the mirror by default.
            harmonics: Of that turn that are taken out.
            exposure_s: Default: found by `auto_exposure` on the target.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            cube = await self._target(at, SLANTED_LINES, half_mm, exposure_s)
            return await _finish(
                output,
                lambda: jitter_from_cube(
                    cube, slant_deg=slant_deg, plane=plane, turn_steps=turn_steps, harmonics=harmonics
                ),
            )

    async def resolution(
        self,
        output: str | Path | None = None,
        *,
        axis: Literal["line", "sample"] = "line",
        plane: Geometry | None = None,
        half_mm: float = 30.0,
        exposure_s: float | None = None,
    ) -> EdgeResponse:
        """Modulation transfer across a slanted edge (figure 11).

        Args:
            output: File of the result.
            axis: ``line`` along the scan, ``sample`` along the slit.
            plane: Geometry as measured; the instrument file's by default.
            half_mm: How far the scan goes to both sides.
            exposure_s: Default: found by `auto_exposure` on the target.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            cube = await self._target(at, SLANTED_EDGE, half_mm, exposure_s)
            return await _finish(output, lambda: edge_from_cube(cube, axis, plane=plane))

    async def wavelength(
        self,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        lines: LineList | None = None,
        exposure_s: float | None = None,
        frames: int = 20,
        degree: int = 2,
    ) -> Wavelength:
        """Wavelengths of the bands, from a spectral lamp in the middle of the slit (Eq. 14, figures 9 and 10).

        Args:
            output: File of the result.
            dark: Dark model; None takes a dark cube as well.
            lines: Of the lamp; mercury-argon by default.
            exposure_s: Default: found by `auto_exposure` on the lamp.
            frames: To average.
            degree: Of the polynomial.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self._station(output) as at:
            await at.look_at(LAMP)
            exposure = exposure_s or (await auto_exposure(self.imager, target=0.7)).exposure_s
            cubes = [await at.still("lamp", LAMP, exposure_s=exposure, frames=frames)]
            if dark is None:
                await at.look_at(DARK)
                cubes.append(await at.still("dark", DARK, exposure_s=exposure, frames=frames))
            return await _finish(output, lambda: wavelength_from_cubes(cubes, dark=dark, lines=lines, degree=degree))

    async def _target(self, at: Station, target: Target, half_mm: float, exposure_s: float | None) -> Path:
        """Scan a target step by step, as far as asked to both sides of the normal, and no farther than the mirror goes."""
        await at.look_at(target)
        geometry, limits = self.imager.instrument.config.geometry, self.imager.instrument.actuator_info.limits
        reach = math.atan(half_mm / (1000 * geometry.distance_m)) / (2 * geometry.step_angle_rad)
        first = max(math.ceil(geometry.normal_step - reach), math.ceil(limits.minimum))
        last = min(math.floor(geometry.normal_step + reach), math.floor(limits.maximum))
        exposure = exposure_s or (await auto_exposure(self.imager)).exposure_s
        plan = self.imager.default_plan(
            lines=last - first + 1, step=1, start=first, exposure_s=exposure, mode="stepped", look_ahead=None
        )
        return await at.take(target.name, target, plan)

    async def _up_to_saturation(self) -> list[float]:
        found = await auto_exposure(self.imager)
        allowed = self.imager.instrument.camera_info.exposure
        full_s = found.exposure_s / found.level
        shares = np.concatenate([np.linspace(allowed.minimum / full_s, 0.85, 8), np.linspace(0.88, 1.2, 10)])
        exposures = shares * full_s  # dense where it saturates: the full well is known as well as they are
        return _rounded(exposures[(exposures >= allowed.minimum) & (exposures <= allowed.maximum)])

    async def _up_to_white(self) -> list[float]:
        found = await auto_exposure(self.imager)
        return _rounded(np.linspace(self.imager.instrument.camera_info.exposure.minimum, found.exposure_s, 5))

    def _dark_exposures(self) -> list[float]:
        allowed = self.imager.instrument.camera_info.exposure
        longest = min(allowed.maximum, _LONGEST_DARK_S)
        return _rounded(np.geomspace(allowed.minimum, longest, _DARK_EXPOSURES))

    @asynccontextmanager
    async def _station(self, output: str | Path | None) -> AsyncGenerator[Station]:
        folder = None if output is None else evidence_folder(output)
        async with station(self.imager, folder, prompt=self.prompt, tell=self.tell) as at:
            yield at


def _rounded(exposures: Iterable[float]) -> list[float]:
    """To the microsecond: nobody wants to read more, and cameras know no more."""
    return [round(float(exposure), 6) for exposure in exposures]


def evidence_folder(output: str | Path) -> Path:
    """Where the cubes of a result are kept."""
    path = Path(output)
    return path.with_name(f"{path.stem}-cubes")


async def _finish(output: str | Path | None, work_out: Callable[[], R]) -> R:
    """Work a result out in a thread, and save it."""
    result = await run_blocking(0.0, work_out)
    if output is not None:
        await run_blocking(0.0, save, result, output)
    return result

"""Wavelengths, from a lamp or a tile, smile and keystone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.smile import Smile
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.characterise.lamp_from_cubes import (
    keystone_from_cubes,
    smile_from_cubes,
    tile_from_cubes,
    wavelength_from_cubes,
)
from scanhsi.characterise.protocols.base import Protocols, R, finish
from scanhsi.characterise.station import DARK, LAMP, SLANTED_LINES, TILE, WHITE, Target


class SpectrographProtocols(Protocols):
    """Protocols of the spectrograph."""

    __slots__ = ()

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

        def work_out(cubes: list[Path]) -> Wavelength:
            return wavelength_from_cubes(cubes, dark=dark, lines=lines, degree=degree)

        return await self._lit(output, [LAMP], dark, exposure_s, 0.7, frames, work_out)

    async def smile(
        self,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        lines: LineList | None = None,
        exposure_s: float | None = None,
        frames: int = 20,
        degree: int = 2,
    ) -> Smile:
        """Smile, and the spectral resolution along the slit, from a spectral lamp that lights all of it (figure 9).

        Args:
            output: File of the result.
            dark: Dark model; None takes a dark cube as well.
            lines: Of the lamp; mercury-argon by default.
            exposure_s: Default: found by `auto_exposure` on the lamp.
            frames: To average.
            degree: Of the polynomial of the wavelengths.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """

        def work_out(cubes: list[Path]) -> Smile:
            return smile_from_cubes(cubes, dark=dark, lines=lines, degree=degree)

        return await self._lit(output, [LAMP], dark, exposure_s, 0.7, frames, work_out)

    async def keystone(
        self,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        exposure_s: float | None = None,
        frames: int = 20,
    ) -> Keystone:
        """Keystone, from the slanted lines with the mirror at rest, and a white tile that shows the response of the pixels.

        Args:
            output: File of the result.
            dark: Dark model; None takes a dark cube as well.
            exposure_s: Default: found by `auto_exposure` on the white tile.
            frames: To average.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """

        def work_out(cubes: list[Path]) -> Keystone:
            return keystone_from_cubes(cubes, dark=dark)

        return await self._lit(output, [WHITE, SLANTED_LINES], dark, exposure_s, 0.85, frames, work_out)

    async def wavelength_tile(
        self,
        certificate: LineList,
        output: str | Path | None = None,
        *,
        dark: DarkModel | None = None,
        exposure_s: float | None = None,
        frames: int = 20,
        degree: int = 2,
        width_bands: float = 16.0,
    ) -> Wavelength:
        """Wavelengths of the bands, from a tile with absorption bands in the light of the usual lamp (figure 9).

        Args:
            certificate: Minima of the tile, as `scanhsi.calibration.lines.load_lines` reads them.
            output: File of the result.
            dark: Dark model; None takes a dark cube as well.
            exposure_s: Default: found by `auto_exposure` on the white tile.
            frames: To average.
            degree: Of the polynomial; 1 where there are fewer than eight minima.
            width_bands: Roughly the width of the narrow minima, in bands.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """

        def work_out(cubes: list[Path]) -> Wavelength:
            return tile_from_cubes(cubes, certificate, dark=dark, degree=degree, width_bands=width_bands)

        return await self._lit(output, [WHITE, TILE], dark, exposure_s, 0.85, frames, work_out)

    async def _lit(
        self,
        output: str | Path | None,
        targets: list[Target],
        dark: DarkModel | None,
        exposure_s: float | None,
        level: float,
        frames: int,
        work_out: Callable[[list[Path]], R],
    ) -> R:
        """Stills of some targets and, without a dark model, of nothing, at the exposure that suits the first."""
        await self.check(dark)
        async with self.station(output) as at:
            cubes: list[Path] = []
            for target in [*targets, *([DARK] if dark is None else [])]:
                await at.look_at(target)
                exposure_s = await self.exposure(exposure_s, target=level)
                cubes.append(await at.still(target.name, target, exposure_s=exposure_s, frames=frames))
            return await finish(output, lambda: work_out(cubes))

"""Dark signal, white reference, photon transfer, signal to noise, stability of the light."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.white import WhiteReference
from scanhsi.characterise.aids import auto_exposure
from scanhsi.characterise.from_cubes import dark_from_cubes, white_from_cubes
from scanhsi.characterise.noise_from_cubes import light_from_cubes, photon_transfer_from_cubes, snr_from_cubes
from scanhsi.characterise.protocols.base import Protocols, finish, rounded
from scanhsi.characterise.station import DARK, WHITE
from scanhsi.clock import now_ns, sleep_until_ns

_DARK_EXPOSURES: Final = 8
_LONGEST_DARK_S: Final = 2.0


class SensorProtocols(Protocols):
    """Protocols of sensor and light."""

    __slots__ = ()

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
        async with self.station(output) as at:
            await at.look_at(DARK)
            cubes = [
                await at.still(f"dark-{number}", DARK, exposure_s=exposure, frames=frames)
                for number, exposure in enumerate(exposures)
            ]
            return await finish(output, lambda: dark_from_cubes(cubes))

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
        await self.check(dark)
        async with self.station(output) as at:
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
            return await finish(output, lambda: white_from_cubes(white, below, tile=tile))

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
        async with self.station(output) as at:
            await at.look_at(WHITE)
            exposures = list(exposures_s) if exposures_s is not None else await self._up_to_saturation()
            cubes = [await at.still(f"flat-{n}", WHITE, exposure_s=t, frames=2) for n, t in enumerate(exposures)]
            await at.look_at(DARK)
            cubes += [await at.still(f"dark-{n}", DARK, exposure_s=t, frames=2) for n, t in enumerate(exposures)]
            return await finish(output, lambda: photon_transfer_from_cubes(cubes))

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
        await self.check(dark)
        async with self.station(output) as at:
            await at.look_at(WHITE)
            exposures = list(exposures_s) if exposures_s is not None else await self._up_to_white()
            cubes = [await at.still(f"white-{n}", WHITE, exposure_s=t, frames=frames) for n, t in enumerate(exposures)]
            if dark is None:
                await at.look_at(DARK)
                cubes += [
                    await at.still(f"dark-{n}", DARK, exposure_s=t, frames=frames) for n, t in enumerate(exposures)
                ]
            return await finish(output, lambda: snr_from_cubes(cubes, dark=dark, tile=tile))

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
        await self.check(dark)
        async with self.station(output) as at:
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
            return await finish(output, lambda: light_from_cubes(cubes, dark=dark, on_before_s=on_before_s))

    async def _up_to_saturation(self) -> list[float]:
        found = await auto_exposure(self.imager)
        allowed = self.imager.instrument.camera_info.exposure
        full_s = found.exposure_s / found.level
        shares = np.concatenate([np.linspace(allowed.minimum / full_s, 0.85, 8), np.linspace(0.88, 1.2, 10)])
        exposures = shares * full_s  # dense where it saturates: the full well is known as well as they are
        return rounded(exposures[(exposures >= allowed.minimum) & (exposures <= allowed.maximum)])

    async def _up_to_white(self) -> list[float]:
        found = await auto_exposure(self.imager)
        return rounded(np.linspace(self.imager.instrument.camera_info.exposure.minimum, found.exposure_s, 5))

    def _dark_exposures(self) -> list[float]:
        allowed = self.imager.instrument.camera_info.exposure
        longest = min(allowed.maximum, _LONGEST_DARK_S)
        return rounded(np.geomspace(allowed.minimum, longest, _DARK_EXPOSURES))

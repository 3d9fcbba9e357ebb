"""``hsi.calibrate``: takes what a calibration needs, works it out, keeps the result and the cubes it came from."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.result import Result, save
from scanhsi.calibration.white import WhiteReference
from scanhsi.characterise.aids import auto_exposure
from scanhsi.characterise.from_cubes import dark_from_cubes, white_from_cubes
from scanhsi.characterise.station import DARK, WHITE, Prompt, Scans, Station, Tell, station
from scanhsi.clock import run_blocking

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

    def _dark_exposures(self) -> list[float]:
        allowed = self.imager.instrument.camera_info.exposure
        longest = min(allowed.maximum, _LONGEST_DARK_S)
        return [float(f"{exposure:.4g}") for exposure in np.geomspace(allowed.minimum, longest, _DARK_EXPOSURES)]

    @asynccontextmanager
    async def _station(self, output: str | Path | None) -> AsyncGenerator[Station]:
        folder = None if output is None else evidence_folder(output)
        async with station(self.imager, folder, prompt=self.prompt, tell=self.tell) as at:
            yield at


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

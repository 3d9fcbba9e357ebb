"""Jitter, backlash and repeatability of the mirror, from the slanted lines."""

from __future__ import annotations

from pathlib import Path

from scanhsi.calibration.backlash import Backlash
from scanhsi.calibration.geometry import Geometry, Turn
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.repeatability import Repeatability
from scanhsi.characterise.mirror_from_cubes import (
    RUN_IN,
    backlash_from_cubes,
    jitter_from_cube,
    repeatability_from_cubes,
)
from scanhsi.characterise.protocols.base import Protocols, finish
from scanhsi.characterise.station import SLANTED_LINES


class MirrorProtocols(Protocols):
    """Protocols of the mirror."""

    __slots__ = ()

    async def jitter(
        self,
        output: str | Path | None = None,
        *,
        plane: Geometry | None = None,
        half_mm: float = 64.0,
        slant_deg: float = 10.0,
        turn: Turn = None,
        harmonics: int = 2,
        exposure_s: float | None = None,
    ) -> Jitter:
        """Jitter of the mirror, line by line, from slanted lines (figure 8).

        Args:
            output: File of the result.
            plane: Geometry as measured; the instrument file's by default.
            half_mm: How far the scan goes to both sides.
            slant_deg: Of the target's lines from the slit.
            turn: Steps of a turn of the shaft that is out of true; ``"find"`` looks for it. None: as the plane has it, else found.
            harmonics: Of that turn that are taken out.
            exposure_s: Default: found by `auto_exposure` on the target.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        await self.check(plane)
        async with self.station(output) as at:
            cube = await self.scan_target(at, SLANTED_LINES, half_mm, exposure_s)
            return await finish(
                output,
                lambda: jitter_from_cube(cube, slant_deg=slant_deg, plane=plane, turn=turn, harmonics=harmonics),
            )

    async def backlash(
        self,
        output: str | Path | None = None,
        *,
        plane: Geometry | None = None,
        half_mm: float = 50.0,
        runs: int = 3,
        exposure_s: float | None = None,
    ) -> Backlash:
        """Backlash of the mirror's drive: the slanted lines are scanned upwards and downwards.

        Args:
            output: File of the result.
            plane: Geometry as measured; the instrument file's by default.
            half_mm: How far the scans go to both sides.
            runs: Scans in either direction.
            exposure_s: Default: found by `auto_exposure` on the target.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        await self.check(plane)
        async with self.station(output) as at:
            await at.look_at(SLANTED_LINES)
            exposure = await self.exposure(exposure_s)
            first, last = self.steps_around(half_mm, spare=RUN_IN)
            up = self.stepwise(first - RUN_IN, last, exposure)
            down = self.stepwise(last + RUN_IN, first, exposure, step=-1)
            cubes: list[Path] = []
            for run in range(runs):
                cubes.append(await at.take(f"upwards-{run}", SLANTED_LINES, up))
                cubes.append(await at.take(f"downwards-{run}", SLANTED_LINES, down))
            return await finish(output, lambda: backlash_from_cubes(cubes, plane=plane, run_in=RUN_IN))

    async def repeatability(
        self,
        output: str | Path | None = None,
        *,
        plane: Geometry | None = None,
        half_mm: float = 50.0,
        positions: int = 11,
        runs: int = 5,
        slant_deg: float = 10.0,
        exposure_s: float | None = None,
    ) -> Repeatability:
        """Repeatability of the mirror (ISO 230-2 style): some positions are approached from below and from above, again and again.

        Args:
            output: File of the result.
            plane: Geometry as measured; the instrument file's by default.
            half_mm: How far the positions reach to both sides.
            positions: How many.
            runs: Approaches to each from either side.
            slant_deg: Of the target's lines from the slit.
            exposure_s: Default: found by `auto_exposure` on the target.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        await self.check(plane)
        async with self.station(output) as at:
            await at.look_at(SLANTED_LINES)
            exposure = await self.exposure(exposure_s)
            low, high = self.steps_around(half_mm)
            stride = max(1, (high - low) // (positions + 1))  # one more to begin with, at either end
            first, last = low + stride, low + stride * positions
            up = self.stepwise(first - stride, last, exposure, step=stride)
            down = self.stepwise(last + stride, first, exposure, step=-stride)
            cubes: list[Path] = []
            for run in range(runs):
                cubes.append(await at.take(f"upwards-{run}", SLANTED_LINES, up))
                cubes.append(await at.take(f"downwards-{run}", SLANTED_LINES, down))
            return await finish(output, lambda: repeatability_from_cubes(cubes, slant_deg=slant_deg, plane=plane))

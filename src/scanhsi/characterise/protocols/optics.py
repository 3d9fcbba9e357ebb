"""Object plane and sharpness, from printed targets."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from scanhsi.calibration.geometry import Geometry, Turn
from scanhsi.calibration.resolution import EdgeResponse
from scanhsi.characterise.protocols.base import Protocols, finish
from scanhsi.characterise.station import GRID, SLANTED_EDGE
from scanhsi.characterise.targets_from_cubes import edge_from_cubes, geometry_from_cube

_SCANS: Final = 6


class OpticsProtocols(Protocols):
    """Protocols of lens and object plane."""

    __slots__ = ()

    async def geometry(
        self,
        output: str | Path | None = None,
        *,
        pitch_mm: float = 6.0,
        half_mm: float = 64.0,
        exposure_s: float | None = None,
        fit_tilt: bool = False,
        origin_known: bool = True,
        turn: Turn = None,
    ) -> Geometry:
        """Distance, normal step and sample pitch, from a grid (figure 7).

        Args:
            output: File of the result.
            pitch_mm: Of the grid.
            half_mm: How far the scan goes to both sides.
            exposure_s: Default: found by `auto_exposure` on the grid.
            fit_tilt: Fit the tilt of the plane, too.
            origin_known: A line of the grid lies at the foot of the normal.
            turn: Steps of a turn of a shaft out of true, which is fitted too; ``"find"`` looks for it.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        async with self.station(output) as at:
            cube = await self.scan_target(at, GRID, half_mm, exposure_s)
            return await finish(
                output,
                lambda: geometry_from_cube(
                    cube, pitch_mm=pitch_mm, fit_tilt=fit_tilt, origin_known=origin_known, turn=turn
                ),
            )

    async def resolution(
        self,
        output: str | Path | None = None,
        *,
        axis: Literal["line", "sample"] = "line",
        plane: Geometry | None = None,
        half_mm: float = 30.0,
        scans: int | None = None,
        exposure_s: float | None = None,
    ) -> EdgeResponse:
        """Modulation transfer across a slanted edge (figure 11).

        Args:
            output: File of the result.
            axis: ``line`` along the scan, ``sample`` along the slit.
            plane: Geometry as measured; the instrument file's by default.
            half_mm: How far the scan goes to both sides.
            scans: How many, to average over the jitter. Default: six along the scan, one along the slit.
            exposure_s: Default: found by `auto_exposure` on the target.

        Raises:
            CalibrationError, ScanFailed, OutOfRange, CubeExists: See `Calibrator`.
        """
        await self.check(plane)
        count = scans or (_SCANS if axis == "line" else 1)
        async with self.station(output) as at:
            await at.look_at(SLANTED_EDGE)
            plan = self.stepwise(*self.steps_around(half_mm), await self.exposure(exposure_s))
            names = [f"{SLANTED_EDGE.name}-{number}" for number in range(count)]
            cubes = [await at.take(name, SLANTED_EDGE, plan) for name in names]
            return await finish(output, lambda: edge_from_cubes(cubes, axis, plane=plane))

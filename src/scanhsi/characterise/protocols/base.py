"""What all protocols share: the instrument, whom to ask, and where results and cubes go."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from scanhsi.calibration.applies import USUAL, Limits, check_applies
from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.result import Result, save
from scanhsi.characterise.aids import auto_exposure
from scanhsi.characterise.station import Prompt, Scans, Station, Target, Tell, station
from scanhsi.clock import run_blocking
from scanhsi.devices import sensor_temperature_c
from scanhsi.devices.errors import CalibrationError
from scanhsi.engine import ScanPlan

R = TypeVar("R", bound=Result)


@dataclass(frozen=True, slots=True)
class Protocols:
    """What a protocol works with.

    Attributes:
        imager: The instrument.
        prompt: Asks a person to put something before it. Simulated instruments are shown their scenes without asking.
        tell: Told what is being done.
        limits: How old, and from how warm a sensor, results may be that a protocol is given.
    """

    imager: Scans
    prompt: Prompt | None = None
    tell: Tell | None = None
    limits: Limits = USUAL

    @asynccontextmanager
    async def station(self, output: str | Path | None) -> AsyncGenerator[Station]:
        """Where the cubes of a result are taken."""
        folder = None if output is None else evidence_folder(output)
        async with station(self.imager, folder, prompt=self.prompt, tell=self.tell) as at:
            yield at

    async def check(self, *results: DarkModel | Geometry | None) -> None:
        """Refuse results that do not apply to what is going to be taken, before anything moves; None is none.

        Raises:
            CalibrationError: One does not; see `check_applies`.
        """
        now = Conditions.of(await attributes_to_be(self.imager, self.imager.default_plan()))
        for result in results:
            if result is not None:  # of a geometry only distance and pitch are used
                check_applies(result, now, self.limits, region=not isinstance(result, Geometry))

    def steps_around(self, half_mm: float, *, spare: int = 0) -> tuple[int, int]:
        """First and last step of a scan that goes so far to both sides of the normal, and no farther than the mirror does.

        Args:
            half_mm: In the object plane.
            spare: Steps to be left to both ends of the mirror's range.

        Raises:
            CalibrationError: Nothing is left.
        """
        geometry, limits = self.imager.instrument.config.geometry, self.imager.instrument.actuator_info.limits
        reach = math.atan(half_mm / (1000 * geometry.distance_m)) / (2 * geometry.step_angle_rad)
        first = max(math.ceil(geometry.normal_step - reach), math.ceil(limits.minimum) + spare)
        last = min(math.floor(geometry.normal_step + reach), math.floor(limits.maximum) - spare)
        if last <= first:
            raise CalibrationError(f"the mirror does not go {half_mm:g} mm to either side.", hint="a smaller field")
        return first, last

    async def exposure(self, exposure_s: float | None, *, target: float = 0.85) -> float:
        """The exposure asked for, or one found on what is before the instrument."""
        return exposure_s or (await auto_exposure(self.imager, target=target)).exposure_s

    def stepwise(self, first: int, last: int, exposure_s: float, *, step: int = 1) -> ScanPlan:
        """A plan from one step to another, line by line, the mirror at rest; downwards where ``step`` is negative."""
        lines = (last - first) // step + 1
        return self.imager.default_plan(
            lines=lines, step=step, start=first, exposure_s=exposure_s, mode="stepped", look_ahead=None
        )

    async def scan_target(self, at: Station, target: Target, half_mm: float, exposure_s: float | None) -> Path:
        """Scan a target step by step, so far to both sides of the normal."""
        await at.look_at(target)
        first, last = self.steps_around(half_mm)
        return await at.take(target.name, target, self.stepwise(first, last, await self.exposure(exposure_s)))


def rounded(exposures: Iterable[float]) -> list[float]:
    """To the microsecond: nobody wants to read more, and cameras know no more."""
    return [round(float(exposure), 6) for exposure in exposures]


def evidence_folder(output: str | Path) -> Path:
    """Where the cubes of a result are kept."""
    path = Path(output)
    return path.with_name(f"{path.stem}-cubes")


async def finish(output: str | Path | None, work_out: Callable[[], R]) -> R:
    """Work a result out in a thread, and save it."""
    result = await run_blocking(0.0, work_out)
    if output is not None:
        await run_blocking(0.0, save, result, output)
    return result


async def attributes_to_be(imager: Scans, plan: ScanPlan) -> dict[str, Any]:
    """What the cube of a scan that is taken now will say of how its counts were taken."""
    instrument, storage = imager.instrument, imager.instrument.config.storage
    return {
        "plan": plan.model_dump(mode="json"),
        "instrument": instrument.config.model_dump(mode="json"),
        "devices": instrument.describe(),
        "binning": {"bands": storage.bin_bands, "samples": storage.bin_samples},
        "sensor_temperature_c": await sensor_temperature_c(imager.camera),
    }

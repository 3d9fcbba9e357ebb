"""Under which conditions counts were taken: what a reference or a calibration must share with what it is used on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self, cast


@dataclass(frozen=True, slots=True)
class Conditions:
    """How counts were taken, as far as their cube says; None is unknown (an imported cube).

    Attributes:
        exposure_s: Exposure time.
        gain_db: Gain.
        pixel_format: Of the camera.
        roi: Region of the sensor, as the instrument file has it: sizes and offsets.
    """

    exposure_s: float | None = None
    gain_db: float | None = None
    pixel_format: str | None = None
    roi: Mapping[str, int] | None = None

    @classmethod
    def of(cls, attributes: Mapping[str, Any]) -> Self:
        """From a cube's attributes."""
        plan = cast("Mapping[str, Any]", attributes.get("plan") or {})
        instrument = cast("Mapping[str, Any]", attributes.get("instrument") or {})
        return cls(plan.get("exposure_s"), plan.get("gain_db"), plan.get("pixel_format"), instrument.get("roi"))

    def differences(self, other: Conditions, *, exposure: bool = True) -> list[str]:
        """What is known of both and not the same, in words; ``exposure`` says whether exposures have to agree."""
        names = ("gain_db", "pixel_format", "roi", *(("exposure_s",) if exposure else ()))
        pairs = [(name, getattr(self, name), getattr(other, name)) for name in names]
        return [
            f"{name} {there} instead of {here}"
            for name, here, there in pairs
            if here is not None and there is not None and here != there
        ]

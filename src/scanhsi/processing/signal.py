"""What the numbers of a line are: their shape, their unit, and under which conditions the camera took them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray


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


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """What goes from one step to the next, besides the numbers.

    Attributes:
        bands, samples: Size of a line.
        dtype: Of its numbers.
        units: ``counts`` as the camera gave them, ``1`` for a ratio such as reflectance.
        long_name: In words.
        saturation: Numbers from here on are saturated; None once they have been masked (nan).
        wavelength_nm: (bands,) float64 where known.
        conditions: Under which the counts were taken.
    """

    bands: int
    samples: int
    dtype: np.dtype[Any]
    units: str
    long_name: str
    saturation: float | None
    wavelength_nm: NDArray[np.float64] | None
    conditions: Conditions

    @classmethod
    def of(cls, dataset: xr.Dataset) -> Self:
        """Of the raw cube in a dataset of `scanhsi.open_cube`."""
        cube = dataset["cube"]
        known = "wavelength" in dataset.coords
        return cls(
            bands=dataset.sizes["band"],
            samples=dataset.sizes["sample"],
            dtype=cube.dtype,
            units="counts" if cube.attrs.get("units") in ("1", None) else str(cube.attrs["units"]),
            long_name=str(cube.attrs.get("long_name", "raw camera counts")),
            saturation=cube.attrs.get("valid_max"),
            wavelength_nm=np.asarray(dataset["wavelength"].values, np.float64) if known else None,
            conditions=Conditions.of(dataset.attrs),
        )

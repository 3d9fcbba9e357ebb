"""What the numbers of a line are: their shape, their unit, and under which conditions the camera took them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.calibration.conditions import Conditions
from scanhsi.cube.layout import CubeSpec


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
        wavelength_map_nm: (bands, samples) float64, of every pixel, where the smile is known and was left.
    """

    bands: int
    samples: int
    dtype: np.dtype[Any]
    units: str
    long_name: str
    saturation: float | None
    wavelength_nm: NDArray[np.float64] | None
    conditions: Conditions
    wavelength_map_nm: NDArray[np.float64] | None = None

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
            wavelength_map_nm=np.asarray(dataset["wavelength_map"].values, np.float64)
            if "wavelength_map" in dataset.coords
            else None,
        )

    @classmethod
    def of_spec(cls, spec: CubeSpec) -> Self:
        """Of the raw cube that will be written as a `CubeSpec` says."""
        stored = spec.stored
        bits = stored.significant_bits
        wavelength = stored.wavelength_nm
        return cls(
            bands=stored.bands,
            samples=stored.samples,
            dtype=np.dtype(stored.dtype),
            units="counts",
            long_name="raw camera counts",
            saturation=None if bits is None else 2**bits - 1,
            wavelength_nm=None if wavelength is None else np.asarray(wavelength, np.float64),
            conditions=Conditions.of(stored.attributes),
        )

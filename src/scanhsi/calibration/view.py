"""A cube at a glance, as figure 14 of the paper: its colours, one band or the ratio of two, spectra drawn at random.

Reflectance becomes colour as it is. Counts need a black and a white, and a raw cube has no references. So it is assumed, band by
band, that the darkest hundredth of the picture is black and that its brightest two-hundredth is a white patch. With a white strip
or tile in view colours are right; without, what is brightest turns white. Where something is known to be white, say so with
``white``. Brightness is relative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.calibration.illuminants import Illuminant, illuminant
from scanhsi.calibration.painting import GROUP_NM, Colouring, Region
from scanhsi.calibration.result import Provenance
from scanhsi.cube.reader import open_cube
from scanhsi.cube.shrink import Means, Reduce, shrink
from scanhsi.cube.spectra import (
    RegionSpectrum,
    Spectra,
    bands_near,
    random_spectra,
    ratio_of,
    region_spectrum,
    stored,
    wavelengths_of,
)
from scanhsi.devices.errors import CubeError

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

_LONGEST_SIDE: Final = 1000
_PERCENTILES: Final = (1.0, 99.5)
_RATIO_SPREADS: Final = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Pictures of a cube; a row of pixels is a few lines, a column a few samples, so that they stay below 1000 pixels.

    Attributes:
        colour: (rows, columns, 3) float32, sRGB from 0 to 1; nan where nothing is known.
        true_colour: False for a cube without all colours from blue to red: then ``colour`` shows thirds of the bands.
        colour_note: How the colours were made, in one line.
        out_of_gamut: Part of the pixels whose colour sRGB cannot show; see `scanhsi.calibration.colour`.
        band: (rows, columns) float32, means, or their ratio; nan where nothing is known.
        band_name: Which band it is (``"803 nm"``).
        quantity: What the cube's numbers are: counts, reflectance.
        band_range: From black to white in the picture of it.
        band_quantity: What those of ``band`` are: the same, or ratio.
        wavelength_nm: (bands,); None where not calibrated.
        missing: (lines,) bool, lines without pixels.
        samples: Samples of a line.
        extent_mm: (left, right, bottom, top) in the object plane; None where the instrument's geometry is not known.
        provenance: Which cube, and how it was taken.
        lines_planned: Lines of the plan.
        spectra: Drawn at random; None if none were wanted.
        regions: Mean spectra of the regions that were asked for.
    """

    colour: Floats32
    true_colour: bool
    colour_note: str
    out_of_gamut: float
    band: Floats32
    band_name: str
    band_range: tuple[float, float]
    quantity: str
    band_quantity: str
    wavelength_nm: Floats | None
    missing: NDArray[np.bool_]
    samples: int
    extent_mm: tuple[float, float, float, float] | None
    provenance: Provenance
    lines_planned: int
    spectra: Spectra | None = None
    regions: tuple[RegionSpectrum, ...] = field(default=())


def view(
    cube: str | Path | xr.Dataset,
    *,
    band_nm: float = 803.0,
    ratio_nm: float | None = None,
    white: Region | None = None,
    light: str | Illuminant = "D65",
    spectra: int = 0,
    seed: int = 0,
    regions: Sequence[Region] = (),
) -> View:
    """Look at a cube. One pass over its shards, in bounded memory; spectra are read besides.

    Args:
        cube: Path or URL of a cube, finished or not, or the dataset of `open_cube`.
        band_nm: Wavelength of the band picture; the nearest band there is. 803 nm shows veins (figure 14 of the paper).
        ratio_nm: If given, the picture is the band over that at this wavelength.
        white: Lines and samples where everything is white.
        light: Illuminant that colours are seen under, or its name.
        spectra: How many to draw at random.
        seed: Of the drawing.
        regions: Lines and samples whose mean spectrum is wanted.

    Raises:
        NotACube, CubeError: It cannot be read, holds no line yet, or none in ``white`` or a region; a ratio without wavelengths.
        ConfigError: No such light.
    """
    light = illuminant(light) if isinstance(light, str) else light
    dataset = cube if isinstance(cube, xr.Dataset) else open_cube(cube, chunks=None)
    name = "the cube" if isinstance(cube, xr.Dataset) else str(cube)
    missing = ~stored(dataset)
    if missing.all():
        raise CubeError(f"{name} holds no line: there is nothing to see.")
    wavelength = wavelengths_of(dataset)
    quantity = str(dataset["cube"].attrs.get("long_name", "")) if dataset["cube"].dtype.kind == "f" else "counts"
    binning = (math.ceil(len(missing) / _LONGEST_SIDE), math.ceil(dataset.sizes["sample"] / _LONGEST_SIDE))
    colouring = Colouring.choose(
        wavelength, dataset.sizes["band"], light, known=quantity == "reflectance" and not white
    )
    shown, band_name = _band(wavelength, dataset.sizes["band"], band_nm)
    wanted: list[Reduce] = [colouring.reduce, Means.of(shown)]
    if ratio_nm is not None:
        if wavelength is None:
            raise CubeError(f"{name} has no wavelengths to make a ratio of.")
        below, below_name = _band(wavelength, len(wavelength), ratio_nm)
        wanted.append(Means.of(below))
        band_name = f"{band_name} / {below_name}"
    planes = shrink(dataset, wanted, binning)
    band = planes[1][0] if ratio_nm is None else ratio_of(planes[1][0], planes[2][0]).astype(np.float32)
    colour, note, beyond = colouring.paint(planes[0], white, binning, name)
    return View(
        colour=colour,
        true_colour=colouring.weights is not None,
        colour_note=note,
        out_of_gamut=beyond,
        band=band,
        band_name=band_name,
        band_range=_band_range(band) if ratio_nm is None else _ratio_range(band, planes[2][0]),
        quantity=quantity,
        band_quantity=quantity if ratio_nm is None else "ratio",
        wavelength_nm=wavelength,
        missing=missing,
        samples=dataset.sizes["sample"],
        extent_mm=_extent_mm(dataset),
        provenance=Provenance.of(dataset, names=(name,)),
        lines_planned=int(dataset.attrs.get("lines_planned", len(missing))),
        spectra=random_spectra(dataset, spectra, seed=seed) if spectra else None,
        regions=tuple(region_spectrum(dataset, *region) for region in regions),
    )


def _band(wavelength: Floats | None, bands: int, nm: float) -> tuple[slice, str]:
    """The band nearest to a wavelength with its neighbours, and what to call it."""
    if wavelength is None:
        index = bands * 3 // 4
        return slice(index, index + 1), f"band {index} of {bands}"
    nearest = float(wavelength[np.abs(wavelength - nm).argmin()])
    name = f"{nearest:.0f} nm" if abs(nearest - nm) < GROUP_NM else f"{nearest:.0f} nm (nearest to {nm:g} nm)"
    return bands_near(wavelength, nm), name


def _band_range(band: Floats32) -> tuple[float, float]:
    known = band[np.isfinite(band)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, _PERCENTILES).tolist()
    return low, max(high, low + 1e-3)


def _ratio_range(ratio: Floats32, below: Floats32) -> tuple[float, float]:
    """Around the median by light: the ratios of what is dark spread widely, and say least."""
    known = np.isfinite(ratio)
    if not known.any():
        return 0.0, 1.0
    values, weight = ratio[known].astype(np.float64), below[known].astype(np.float64)
    middle = _median(values, weight)
    spread = max(_RATIO_SPREADS * _median(np.abs(values - middle), weight), 1e-3)
    return max(middle - spread, float(values.min())), min(middle + spread, float(values.max())) + 1e-6


def _median(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    summed = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(summed, summed[-1] / 2)]])


def _extent_mm(dataset: xr.Dataset) -> tuple[float, float, float, float] | None:
    """Where the picture lies in the object plane: as the cube's own coordinates say, else y = -r tan(2 angle), Eqs. 8 and 12."""
    if "x" in dataset.coords and "y" in dataset.coords and min(dataset["x"].size, dataset["y"].size) > 1:
        (left, right), (top, bottom) = (_edges(np.asarray(dataset[name].values, np.float64)) for name in "xy")
        return left, right, bottom, top
    instrument = cast("dict[str, Any]", dataset.attrs.get("instrument") or {})
    geometry = cast("dict[str, Any]", instrument.get("geometry") or {})
    pitch_m, distance_m = geometry.get("sample_pitch_m"), geometry.get("distance_m")
    angles = np.asarray(dataset["mirror_angle_rad"].values) if "mirror_angle_rad" in dataset else np.zeros(0)
    angles = angles[np.isfinite(angles)]
    if not pitch_m or not distance_m or len(angles) < 2 or angles[0] == angles[-1]:
        return None
    top, bottom = (-1e3 * distance_m * math.tan(2 * float(angle)) for angle in (angles[0], angles[-1]))
    binned = cast("dict[str, Any]", dataset.attrs.get("binning") or {}).get("samples", 1)
    half = 0.5e3 * pitch_m * binned * dataset.sizes["sample"]
    return -half, half, bottom, top


def _edges(centres: Floats) -> tuple[float, float]:
    half = float(centres[-1] - centres[0]) / (len(centres) - 1) / 2
    return float(centres[0]) - half, float(centres[-1]) + half

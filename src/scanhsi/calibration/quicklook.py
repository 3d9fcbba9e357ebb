"""A first look at a raw cube: its colours, and one band.

Colour needs reflectance, and a raw cube has no references (a cube of reflectance needs none). So it is assumed, band by band,
that the darkest hundredth of the picture is black and that its brightest two-hundredth is a white patch. With a white strip or tile
in view colours are right; without, what is brightest turns white. Where something is known to be white, say so with ``white``.
Brightness is relative.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.calibration.colour import VISIBLE_NM, xyz_matrix, xyz_to_srgb
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CubeError

Floats = NDArray[np.float32]

_LONGEST_SIDE: Final = 1000
_GROUP_NM: Final = 10.0
_BAND_WIDTH_NM: Final = 2.7  # a channel of the paper: five rows
_PERCENTILES: Final = (1.0, 99.5)
_BLOCK_BYTES: Final = 64_000_000


@dataclass(frozen=True, slots=True)
class Quicklook:
    """Pictures of a cube; a row of pixels is a few lines, a column a few samples, so that they stay below 1000 pixels.

    Attributes:
        colour: (rows, columns, 3) float32, sRGB from 0 to 1; nan where no line is stored.
        true_colour: False for a cube without visible wavelengths: then ``colour`` shows thirds of the bands.
        colour_note: How the colours were made, in one line.
        band: (rows, columns) float32, means; nan where no line is stored.
        band_name: Which band it is (``"803 nm"``).
        quantity: What its numbers are: counts, reflectance.
        missing: (lines,) bool, lines without pixels.
        samples: Samples of a line.
        extent_mm: (left, right, bottom, top) in the object plane; None where the instrument's geometry is not known.
        simulated: Whether the cube is.
        lines_planned: Lines of the plan.
    """

    colour: Floats
    true_colour: bool
    colour_note: str
    band: Floats
    band_name: str
    quantity: str
    missing: NDArray[np.bool_]
    samples: int
    extent_mm: tuple[float, float, float, float] | None
    simulated: bool
    lines_planned: int


@dataclass(frozen=True, slots=True)
class _Bands:
    """Bands to read. Neighbours are averaged: colour does not need less than some 10 nm.

    Attributes:
        edges: First band of each group, and the end of the last group.
        wavelength_nm: Mean of each group; None for groups that are thirds of all bands.
        shown: The bands of the band picture.
        name: What they are called.
    """

    edges: NDArray[np.intp]
    wavelength_nm: NDArray[np.float64] | None
    shown: slice
    name: str


def quicklook(
    cube: str | Path | xr.Dataset, *, band_nm: float = 803.0, white: tuple[slice, slice] | None = None
) -> Quicklook:
    """Look at a cube. One pass over its shards, in bounded memory.

    Args:
        cube: Path of a cube, finished or not, or the dataset of `open_cube`.
        band_nm: Wavelength of the band picture; the nearest band there is. 803 nm shows veins (figure 14 of the paper).
        white: Lines and samples where everything is white.

    Raises:
        NotACube, CubeError: It cannot be read, holds no line yet, or none in ``white``.
    """
    dataset = cube if isinstance(cube, xr.Dataset) else open_cube(cube, chunks=None)
    missing = np.asarray(dataset["status"].values != LineStatus.STORED)
    if missing.all():
        raise CubeError(f"{_name(cube)} holds no line: there is nothing to see.")
    bands = _choose_bands(dataset, band_nm)
    binning = (math.ceil(len(missing) / _LONGEST_SIDE), math.ceil(dataset.sizes["sample"] / _LONGEST_SIDE))
    spectra, band = _shrink(dataset, bands, ~missing, binning)
    quantity = str(dataset["cube"].attrs.get("long_name", "")) if dataset["cube"].dtype.kind == "f" else "counts"
    if quantity == "reflectance" and white is None:
        black, reference, note = (
            np.zeros(len(spectra), np.float32),
            np.ones(len(spectra), np.float32),
            "of the reflectance",
        )
    else:
        black, reference, note = _references(spectra, white, binning, _name(cube))
    colour, how = _colours(spectra, black, np.maximum(reference - black, 1e-3), bands.wavelength_nm)
    return Quicklook(
        colour=colour,
        true_colour=bands.wavelength_nm is not None,
        colour_note=f"{how}; {note}",
        band=band,
        band_name=bands.name,
        quantity=quantity,
        missing=missing,
        samples=dataset.sizes["sample"],
        extent_mm=_extent_mm(dataset),
        simulated=dataset.attrs.get("simulated") is True,
        lines_planned=int(dataset.attrs.get("lines_planned", len(missing))),
    )


def _name(cube: str | Path | xr.Dataset) -> str:
    return "the cube" if isinstance(cube, xr.Dataset) else str(cube)


def _colours(
    spectra: Floats, black: Floats, span: Floats, wavelength_nm: NDArray[np.float64] | None
) -> tuple[Floats, str]:
    """sRGB (rows, columns, 3) of counts (groups, rows, columns), and how it was made."""
    if wavelength_nm is None:
        thirds = [np.clip((spectra[group] - black[group]) / span[group], 0, 1) for group in (-1, len(spectra) // 2, 0)]
        return np.stack(thirds, axis=-1) ** np.float32(
            1 / 2.2
        ), "false colour: thirds of the bands, no visible wavelengths"
    weights = (xyz_matrix(wavelength_nm) / span[:, None]).astype(np.float32)  # reflectance is (counts - black) / span
    xyz = np.tensordot(spectra, weights, axes=(0, 0)) - black @ weights
    return xyz_to_srgb(xyz).astype(np.float32), "CIE 1931, D65"


def _choose_bands(dataset: xr.Dataset, band_nm: float) -> _Bands:
    bands = dataset.sizes["band"]
    thirds = np.unique(np.linspace(0, bands, 4).astype(np.intp))
    if "wavelength" not in dataset.coords:
        index = bands * 3 // 4
        return _Bands(thirds, None, slice(index, index + 1), f"band {index} of {bands}")
    wavelength = np.asarray(dataset["wavelength"].values, np.float64)
    nearest = float(wavelength[np.abs(wavelength - band_nm).argmin()])
    chosen = np.flatnonzero(np.abs(wavelength - nearest) <= _BAND_WIDTH_NM / 2)
    shown = slice(int(chosen[0]), int(chosen[-1]) + 1)
    name = (
        f"{nearest:.0f} nm" if abs(nearest - band_nm) < _GROUP_NM else f"{nearest:.0f} nm (nearest to {band_nm:g} nm)"
    )
    visible = np.flatnonzero((wavelength >= VISIBLE_NM[0]) & (wavelength <= VISIBLE_NM[1]))
    if visible.size < 3:
        return _Bands(thirds, None, shown, name)
    first, stop = int(visible[0]), int(visible[-1]) + 1
    number = np.floor(np.abs(wavelength[first:stop] - wavelength[first]) / _GROUP_NM)
    edges = np.append(first + np.flatnonzero(np.diff(number, prepend=-1.0)), stop)
    centres = np.add.reduceat(wavelength[:stop], edges[:-1]) / np.diff(edges)
    return _Bands(edges, centres, shown, name)


def _shrink(
    dataset: xr.Dataset, bands: _Bands, stored: NDArray[np.bool_], binning: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Mean counts of the groups, (groups, rows, columns), and of the band picture; nan where no line is stored."""
    rows, columns = -(-len(stored) // binning[0]), -(-dataset.sizes["sample"] // binning[1])
    spectra = np.full((len(bands.edges) - 1, rows, columns), np.nan, np.float32)
    band = np.full((1, rows, columns), np.nan, np.float32)
    first, stop = int(bands.edges[0]), int(bands.edges[-1])
    shown = np.array([0, bands.shown.stop - bands.shown.start])
    for block in _blocks(dataset["cube"], binning[0]):
        good = np.flatnonzero(stored[block])
        if not good.size:
            continue
        place, starts, counts = np.unique((good + block.start) // binning[0], return_index=True, return_counts=True)
        pixels = dataset["cube"].isel(line=block)
        for target, within, edges in ((spectra, slice(first, stop), bands.edges - first), (band, bands.shown, shown)):
            means = _means(np.asarray(pixels.isel(band=within).values), edges, binning[1])
            target[:, place] = np.add.reduceat(means[:, good], starts, axis=1) / counts[:, None].astype(np.float32)
    return spectra, band[0]


def _blocks(cube: xr.DataArray, binning: int) -> Iterator[slice]:
    """Lines to be read together: some shards, and whole rows of the picture."""
    bands, lines, samples = cube.shape
    shard = int((cube.encoding.get("shards") or (bands, 16, samples))[1])
    shards = max(1, _BLOCK_BYTES // (bands * samples * cube.dtype.itemsize * shard))
    size = math.lcm(shard, binning) if binning <= shard else binning
    size *= max(1, shards * shard // size)
    for start in range(0, lines, size):
        yield slice(start, min(start + size, lines))


def _means(values: NDArray[Any], edges: NDArray[np.intp], size: int) -> Floats:
    """Means over groups of bands and over ``size`` neighbouring samples: (groups, lines, columns)."""
    starts = np.arange(0, values.shape[2], size, dtype=np.intp)
    sums = np.float64 if values.dtype.kind == "f" else np.uint32
    groups = (values[low:high].sum(axis=0, dtype=sums) for low, high in pairwise(edges))
    summed = np.stack([np.add.reduceat(group, starts, axis=1) for group in groups])
    pixels = np.diff(edges)[:, None, None] * np.diff(np.append(starts, values.shape[2]))
    return (summed / pixels).astype(np.float32)


def _references(
    spectra: Floats, white: tuple[slice, slice] | None, binning: tuple[int, int], name: str
) -> tuple[Floats, Floats, str]:
    """Black and white level of each group, and in words where they come from."""
    black, brightest = np.nanpercentile(spectra, _PERCENTILES, axis=(1, 2)).astype(np.float32)
    if white is None:
        return black, brightest, "assumed: darkest 1 % black, brightest 0.5 % white"
    place = tuple(
        slice((region.start or 0) // size, None if region.stop is None else -(-region.stop // size))
        for region, size in zip(white, binning, strict=True)
    )
    patch = spectra[(slice(None), *place)]
    if not np.isfinite(patch).any():
        raise CubeError(f"{name} has no stored line in the white region.")
    return black, np.nanmean(patch, axis=(1, 2)), "white as given; assumed: darkest 1 % black"


def _extent_mm(dataset: xr.Dataset) -> tuple[float, float, float, float] | None:
    """Where the picture lies in the object plane: y = -r tan(2 angle), Eqs. 8 and 12, and x from the pitch of the samples."""
    instrument = cast("dict[str, Any]", dataset.attrs.get("instrument") or {})
    geometry = cast("dict[str, Any]", instrument.get("geometry") or {})
    pitch_m, distance_m = geometry.get("sample_pitch_m"), geometry.get("distance_m")
    angles = np.asarray(dataset["mirror_angle_rad"].values)
    angles = angles[np.isfinite(angles)]
    if not pitch_m or not distance_m or len(angles) < 2 or angles[0] == angles[-1]:
        return None
    top, bottom = (-1e3 * distance_m * math.tan(2 * float(angle)) for angle in (angles[0], angles[-1]))
    binned = cast("dict[str, Any]", dataset.attrs.get("binning") or {}).get("samples", 1)
    half = 0.5e3 * pitch_m * binned * dataset.sizes["sample"]
    return -half, half, bottom, top

"""Spectra and bands of a cube as arrays: of a pixel, over a region, at random; one band, the ratio of two.

All take a dataset of `scanhsi.open_cube` (``chunks=None`` reads quickest) and read what they need, some lines at a time: memory
stays bounded whatever the cube's size. Lines that are not stored are no measurement and do not count, nor does nan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CubeError

Floats = NDArray[np.float64]

CHANNEL_NM: Final = 2.7
"""Width of a channel of the paper: five rows of its sensor."""

_BLOCK_BYTES: Final = 16_000_000
_TRIES: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Spectra of some pixels.

    Attributes:
        values: (spectrum, band) float64.
        lines, samples: Where they are, (spectrum,).
    """

    values: Floats
    lines: NDArray[np.intp]
    samples: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class RegionSpectrum:
    """What the pixels of a region come to, band by band.

    Attributes:
        mean: (band,) float64; nan where there is no number.
        sigma: Standard deviation over the pixels, (band,); nan of fewer than two.
        count: Pixels that are numbers, (band,).
        lines, samples: First and end of the region.
    """

    mean: Floats
    sigma: Floats
    count: NDArray[np.int64]
    lines: tuple[int, int]
    samples: tuple[int, int]


def wavelengths_of(dataset: xr.Dataset) -> Floats | None:
    """Wavelengths of the bands in nm, (band,); None of a cube that was not calibrated."""
    return np.asarray(dataset["wavelength"].values, np.float64) if "wavelength" in dataset.coords else None


def stored(dataset: xr.Dataset) -> NDArray[np.bool_]:
    """Which lines are stored, (line,)."""
    return np.asarray(dataset["status"].values == LineStatus.STORED)


def spectrum_at(dataset: xr.Dataset, line: int, sample: int) -> Floats:
    """Spectrum of one pixel, (band,).

    Raises:
        CubeError: It lies outside of the cube, or its line is missing.
    """
    for name, index in (("line", line), ("sample", sample)):
        if not 0 <= index < dataset.sizes[name]:
            raise CubeError(f"there is no {name} {index}: the cube has {dataset.sizes[name]}.")
    if int(dataset["status"].values[line]) != LineStatus.STORED:
        raise CubeError(f"line {line} is missing.", hint="scanhsi info tells which, and why")
    return np.asarray(dataset["cube"].isel(line=line, sample=sample).values, np.float64)


def _told(part: slice) -> str:
    return ":".join("" if end is None else str(end) for end in (part.start, part.stop))


def region_spectrum(dataset: xr.Dataset, lines: slice = slice(None), samples: slice = slice(None)) -> RegionSpectrum:
    """Mean, spread and number of the pixels of a region.

    Raises:
        CubeError: It holds no stored line, or no sample.
    """
    first, end, _ = lines.indices(dataset.sizes["line"])
    left, right, _ = samples.indices(dataset.sizes["sample"])
    here = np.flatnonzero(stored(dataset)[first:end]) + first
    if not here.size or right <= left:
        raise CubeError(
            f"lines {_told(lines)}, samples {_told(samples)} hold no pixel of this cube of "
            f"{dataset.sizes['line']} lines and {dataset.sizes['sample']} samples, "
            f"of which {stored(dataset).sum()} lines are stored."
        )
    bands = dataset.sizes["band"]
    count, total, squares = np.zeros(bands, np.int64), np.zeros(bands), np.zeros(bands)
    around: Floats | None = None
    for block in _blocks(dataset, here, slice(left, right)):
        pixels = block.reshape(bands, -1)
        gaps = ~np.isfinite(pixels) if dataset["cube"].dtype.kind == "f" else np.zeros(pixels.shape, bool)
        if around is None:  # sums of squares around it lose no digits
            around = np.array([row[~gap][0] if not gap.all() else 0.0 for row, gap in zip(pixels, gaps, strict=True)])
        away = pixels - around[:, None]
        if gaps.any():
            away[gaps] = 0.0
        count += pixels.shape[1] - gaps.sum(axis=1)
        total += away.sum(axis=1)
        squares += np.einsum("bp,bp->b", away, away)
    assert around is not None, "there is a line"
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(count > 0, around + total / count, np.nan)
        variance = np.where(count > 1, (squares - total**2 / count) / (count - 1), np.nan)
    return RegionSpectrum(mean, np.sqrt(np.maximum(variance, 0)), count, (first, end), (left, right))


def _blocks(dataset: xr.Dataset, lines: NDArray[np.intp], samples: slice) -> Iterator[Floats]:
    """Some lines at a time, (band, line, sample) float64. What lies in one chunk is read at once, and made floats in parts."""
    cube = dataset["cube"].isel(sample=samples)
    chunk = int((cube.encoding.get("chunks") or (1, 1, 1))[1])
    line_bytes = 8 * cube.sizes["band"] * max(1, cube.sizes["sample"])
    together = chunk * max(1, _BLOCK_BYTES // (line_bytes * chunk))
    part = max(1, _BLOCK_BYTES // line_bytes)
    for some in np.split(lines, np.flatnonzero(np.diff(lines // together)) + 1):
        even = some[-1] - some[0] == len(some) - 1
        block = np.asarray(cube.isel(line=slice(int(some[0]), int(some[-1]) + 1) if even else some).values)
        for first in range(0, len(some), part):
            yield block[:, first : first + part].astype(np.float64)


def random_spectra(dataset: xr.Dataset, count: int = 100, *, seed: int = 0) -> Spectra:
    """Spectra of pixels drawn at random from the stored lines, each pixel once; the same for the same seed.

    Pixels without any number (nan in every band) are drawn anew.

    Args:
        dataset: Of `scanhsi.open_cube`.
        count: How many; fewer where the cube has fewer.
        seed: Of the drawing.

    Raises:
        CubeError: No line is stored, or no pixel is a number.
    """
    lines, samples = np.flatnonzero(stored(dataset)), dataset.sizes["sample"]
    pixels = len(lines) * samples
    drawn = np.random.default_rng(seed).choice(pixels, min(pixels, _TRIES * count), replace=False)
    found: list[tuple[Floats, int, int]] = []
    while drawn.size and len(found) < count:
        some, drawn = np.split(drawn, [count - len(found)])
        places = lines[some // samples], some % samples
        spectra = _spectra(dataset["cube"], *places)
        good = np.isfinite(spectra).any(axis=1)
        found += zip(spectra[good], places[0][good].tolist(), places[1][good].tolist(), strict=True)
    if not found:
        raise CubeError("the cube holds no pixel that is a number.")
    values, at_lines, at_samples = zip(*sorted(found, key=lambda one: one[1:]), strict=True)
    return Spectra(np.stack(values), np.array(at_lines, np.intp), np.array(at_samples, np.intp))


def _spectra(cube: xr.DataArray, lines: NDArray[np.intp], samples: NDArray[np.intp]) -> Floats:
    """Of pixels anywhere, (pixel, band); what lies in the same chunks is read together, for each of them costs a request."""
    spectra = np.empty((len(lines), cube.sizes["band"]))
    height = (cube.encoding.get("shards") or cube.encoding.get("chunks") or cube.shape)[1]
    width = (cube.encoding.get("chunks") or cube.shape)[2]
    chunk = (lines // height) * (cube.sizes["sample"] // width + 1) + samples // width
    for one in np.unique(chunk):
        here = np.flatnonzero(chunk == one)
        rows, row = np.unique(lines[here], return_inverse=True)
        columns, column = np.unique(samples[here], return_inverse=True)
        spectra[here] = cube.isel(line=rows, sample=columns).values[:, row, column].T
    return spectra


def bands_near(wavelength_nm: Floats, nm: float, width_nm: float = CHANNEL_NM) -> slice:
    """The nearest band to a wavelength, and its neighbours within a width; one band where bands are wider.

    Args:
        wavelength_nm: (band,), ascending or descending.
        nm: Where.
        width_nm: How wide.
    """
    nearest = float(wavelength_nm[np.abs(wavelength_nm - nm).argmin()])
    chosen = np.flatnonzero(np.abs(wavelength_nm - nearest) <= width_nm / 2)
    return slice(int(chosen[0]), int(chosen[-1]) + 1)


def band_picture(dataset: xr.Dataset, nm: float, width_nm: float = CHANNEL_NM) -> Floats:
    """Mean of the bands around a wavelength, (line, sample) float64; nan where a line is not stored.

    Raises:
        CubeError: The cube has no wavelengths.
    """
    wavelength = wavelengths_of(dataset)
    if wavelength is None:
        raise CubeError("the cube has no wavelengths.", hint="scanhsi process, with a wavelength calibration")
    shown = bands_near(wavelength, nm, width_nm)
    picture = np.full((dataset.sizes["line"], dataset.sizes["sample"]), np.nan)
    lines = np.flatnonzero(stored(dataset))
    first = 0
    for block in _blocks(dataset.isel(band=shown), lines, slice(None)):
        picture[lines[first : first + block.shape[1]]] = block.mean(axis=0)
        first += block.shape[1]
    return picture


def ratio_of(above: NDArray[Any], below: NDArray[Any]) -> Floats:
    """One picture over another; nan where the other is not above zero."""
    numerator, denominator = np.asarray(above, np.float64), np.asarray(below, np.float64)
    good = denominator > 0
    return np.where(good, numerator / np.where(good, denominator, 1.0), np.nan)


def band_ratio(dataset: xr.Dataset, above_nm: float, below_nm: float, width_nm: float = CHANNEL_NM) -> Floats:
    """Ratio of the bands around two wavelengths, (line, sample); nan where unknown. Of reflectance: counts hold a dark level.

    Raises:
        CubeError: The cube has no wavelengths.
    """
    return ratio_of(band_picture(dataset, above_nm, width_nm), band_picture(dataset, below_nm, width_nm))

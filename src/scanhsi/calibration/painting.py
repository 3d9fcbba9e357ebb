"""Colours of pictures of a cube: of reflectance as they are; of counts between the black and the white that a picture shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration import colour as colours
from scanhsi.calibration.colour import VISIBLE_NM
from scanhsi.calibration.illuminants import Illuminant
from scanhsi.cube.shrink import Means, Reduce, Weighted
from scanhsi.devices.errors import CubeError

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Region = tuple[slice, slice]

GROUP_NM: Final = 10.0
_NEEDED_NM: Final = (450.0, 650.0)  # a cube that begins or ends between them has no true colours
_PERCENTILES: Final = (1.0, 99.5)


@dataclass(frozen=True, slots=True)
class Colouring:
    """How pixels become colours.

    Attributes:
        reduce: What is read: XYZ itself where the numbers are reflectance; else groups of bands, for which black and white are
            found. Colour does not need less than some 10 nm, and groups keep the spectra of a picture small.
        weights: Of the groups in XYZ, (groups, 3); None for false colours.
        light: That they are seen under.
        known: Whether the numbers are reflectance.
    """

    reduce: Reduce
    weights: Floats | None
    light: Illuminant
    known: bool

    @classmethod
    def choose(cls, wavelength: Floats | None, bands: int, light: Illuminant, *, known: bool) -> Colouring:
        """For a cube of so many bands; true colours if they reach from blue to red."""
        if wavelength is None or wavelength.min() > _NEEDED_NM[0] or wavelength.max() < _NEEDED_NM[1]:
            thirds = np.unique(np.linspace(0, bands, 4).astype(np.intp))
            return cls(Means(thirds), None, light, known)
        visible = np.flatnonzero((wavelength >= VISIBLE_NM[0]) & (wavelength <= VISIBLE_NM[1]))
        first, stop = int(visible[0]), int(visible[-1]) + 1
        if known:
            weights = colours.xyz_matrix(wavelength[first:stop], light)
            return cls(Weighted(slice(first, stop), weights.T.astype(np.float32)), weights, light, known)
        number = np.floor(np.abs(wavelength[first:stop] - wavelength[first]) / GROUP_NM)
        edges = np.append(first + np.flatnonzero(np.diff(number, prepend=-1.0)), stop)
        centres = np.add.reduceat(wavelength[:stop], edges[:-1]) / np.diff(edges)
        return cls(Means(edges), colours.xyz_matrix(centres, light), light, known)

    def paint(
        self, planes: Floats32, white: Region | None, binning: tuple[int, int], name: str
    ) -> tuple[Floats32, str, float]:
        """sRGB (rows, columns, 3), how it was made, and the part of it that is out of gamut."""
        if self.known:
            black, reference, note = np.zeros(len(planes)), np.ones(len(planes)), "of the reflectance"
        else:
            black, reference, note = _references(planes, white, binning, name)
        span = np.maximum(reference - black, 1e-3)
        if self.weights is None:
            groups = (-1, len(planes) // 2, 0)
            thirds = [np.clip((planes[group] - black[group]) / span[group], 0, 1) for group in groups]
            picture = np.stack(thirds, axis=-1) ** (1 / 2.2)
            return picture.astype(np.float32), f"false colour: thirds of the bands; {note}", 0.0
        if self.known:
            xyz = np.moveaxis(planes, 0, -1).astype(np.float64)
        else:
            weights = self.weights / span[:, None]  # reflectance is (counts - black) / span
            xyz = np.tensordot(planes, weights.astype(np.float32), axes=(0, 0)) - black @ weights
        linear = colours.xyz_to_linear(xyz, self.weights.sum(axis=0))
        known = np.isfinite(linear).all(axis=-1)
        beyond = float(colours.out_of_gamut(linear[known]).mean()) if known.any() else 0.0
        picture = colours.encode(colours.into_gamut(linear)).astype(np.float32)
        return picture, f"CIE 1931, {self.light.name}; {note}", beyond


def _references(
    spectra: Floats32, white: Region | None, binning: tuple[int, int], name: str
) -> tuple[Floats, Floats, str]:
    """Black and white level of each group, and in words where they come from."""
    known = [values[np.isfinite(values)] for values in spectra]
    empty = (np.nan, np.nan)
    levels = np.array([np.percentile(values, _PERCENTILES) if values.size else empty for values in known])
    black, brightest = levels.T
    if white is None:
        return black, brightest, "assumed: darkest 1 % black, brightest 0.5 % white"
    place = tuple(
        slice((region.start or 0) // size, None if region.stop is None else -(-region.stop // size))
        for region, size in zip(white, binning, strict=True)
    )
    patch = spectra[(slice(None), *place)]
    seen = np.isfinite(patch).all(axis=0)
    if not seen.any():
        raise CubeError(f"{name} has no stored line in the white region.")
    return black, patch[:, seen].mean(axis=1, dtype=np.float64), "white as given; assumed: darkest 1 % black"

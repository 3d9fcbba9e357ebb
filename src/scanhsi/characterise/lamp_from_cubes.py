"""Wavelengths, smile and keystone, from cubes of a lamp, of a tile with absorption bands, and of structure along the slit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.keystone import Keystone, fit_keystone
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.smile import Smile, calibrate_spectrograph
from scanhsi.calibration.tile import calibrate_with_tile
from scanhsi.calibration.wavelength import Wavelength, calibrate_with_lamp
from scanhsi.characterise.lit_from_cubes import lit_frames
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Path_ = str | Path

_SAMPLES: Final = 100
"""Around the middle of the region: smile is nothing there, and this many average well."""

_DIM: Final = 0.03  # of the brightest band: below, a ratio to the white tile is noise


def wavelength_from_cubes(
    cubes: Sequence[Path_], *, dark: DarkModel | None = None, lines: LineList | None = None, degree: int = 2
) -> Wavelength:
    """Calibrate with a lamp, in the middle of the slit.

    Args:
        cubes: One of the lamp, and a dark one of the same exposure where there is no model.
        dark: Dark model instead.
        lines: Of the lamp; mercury-argon by default.
        degree: Of the polynomial.

    Raises:
        CalibrationError: Not these cubes; see `calibrate_with_lamp`.
    """
    lit = lit_frames(cubes, dark)
    return calibrate_with_lamp(_middle(lit.only("the lamp")), lit.provenance, lines=lines, degree=degree)


def _middle(frame: Floats) -> Floats:
    """Spectrum in the middle of the slit: the median of the samples, which does not see a pixel that is off."""
    middle = frame.shape[1] // 2
    some = frame[:, max(0, middle - _SAMPLES // 2) : middle + _SAMPLES // 2]
    known = np.isfinite(some).mean(axis=1) > 0.5
    spectrum = np.full(len(some), np.nan)
    spectrum[known] = np.nanmedian(some[known], axis=1)
    return spectrum


def smile_from_cubes(
    cubes: Sequence[Path_], *, dark: DarkModel | None = None, lines: LineList | None = None, degree: int = 2
) -> Smile:
    """Smile, and the spectral resolution along the slit, with a lamp that lights all of it.

    Args:
        cubes: As for `wavelength_from_cubes`: the same will do.
        dark: Dark model.
        lines: Of the lamp; mercury-argon by default.
        degree: Of the polynomial of the wavelengths.

    Raises:
        CalibrationError: Not these cubes; see `calibrate_spectrograph`.
    """
    lit = lit_frames(cubes, dark)
    return calibrate_spectrograph(lit.only("the lamp"), lit.provenance, lines=lines, degree=degree)[1]


def keystone_from_cubes(cubes: Sequence[Path_], *, dark: DarkModel | None = None, white: str = "white") -> Keystone:
    """Keystone, from a target with structure along the slit, the mirror at rest.

    Args:
        cubes: One of the target, and a dark one of the same exposure where there is no model; with one of a white tile the response
            of single pixels is divided out, which would count as structure.
        dark: Dark model instead.
        white: What the cube of the white tile says that it is of.

    Raises:
        CalibrationError: Not these cubes; see `fit_keystone`.
    """
    lit = lit_frames(cubes, dark)
    flat = lit.frames.pop(white, None)
    frame = lit.only("the target")
    if flat is not None:
        smooth = np.nanmedian(
            flat, axis=1, keepdims=True
        )  # of each band: brightness stays, and with it the weight of noise
        with np.errstate(divide="ignore", invalid="ignore"):
            frame = np.where(flat > 0, frame * smooth / flat, np.nan)
    return fit_keystone(frame, lit.provenance)


def tile_from_cubes(
    cubes: Sequence[Path_],
    certificate: LineList,
    *,
    dark: DarkModel | None = None,
    degree: int = 2,
    width_bands: float = 16.0,
    white: str = "white",
) -> Wavelength:
    """Calibrate with a tile that has absorption bands, in the middle of the slit.

    Args:
        cubes: One of the tile, one of a white tile in the same light, and a dark one of the same exposure where there is no model.
        certificate: Minima of the tile.
        dark: Dark model instead.
        degree: Of the polynomial.
        width_bands: Roughly the width of the narrow minima, in bands.
        white: What the cube of the white tile says that it is of.

    Raises:
        CalibrationError: Not these cubes; see `calibrate_with_tile`.
    """
    lit = lit_frames(cubes, dark)
    if len(lit.frames) != 2 or white not in lit.frames:
        raise CalibrationError(
            f"one cube of the tile and one of the {white} tile are needed, not of {', '.join(lit.frames) or 'nothing'}."
        )
    below = _middle(lit.frames[white])
    above = _middle(next(frame for name, frame in lit.frames.items() if name != white))
    used = _lit_bands(below, above)
    return calibrate_with_tile(
        above[used] / below[used],
        certificate,
        lit.provenance,
        degree=degree,
        fwhm_bands=width_bands,
        first_band=used.start,
        bands=len(below),
    )


def _lit_bands(white: Floats, tile: Floats) -> slice:
    """The longest run of bands in which there is light and nothing is saturated."""
    good = np.isfinite(white) & np.isfinite(tile)
    good[good] = white[good] > _DIM * white[good].max(initial=0.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False])).astype(np.int8)))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        raise CalibrationError("the white tile shows no light that is not saturated.")
    low, high = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))].tolist()
    return slice(low, high)

"""Surfaces with spectra of their own: a wavelength standard and a colour checker."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices.errors import ConfigError
from scanhsi_sim.effects import Setup
from scanhsi_sim.optics import FWHM, reflected, wavelengths
from scanhsi_sim.scenes.edges import Floats, Footprint
from scanhsi_sim.scenes.spectral import Everywhere, SpectralScene

Spectrum = NDArray[np.float64]

TILE_CONTINUUM = 0.9
PATCH_MM = 16.0
PATCH_PITCH_MM = 18.0
FRAME_REFLECTANCE = 0.03
ROWS, COLUMNS = 4, 6


def _read(path: Path) -> tuple[list[str], NDArray[np.float64]]:
    """Header and numbers of a table; lines that begin with # are remarks."""
    try:
        rows = [row for row in csv.reader(path.read_text("utf-8").splitlines()) if row and not row[0].startswith("#")]
        return [name.strip() for name in rows[0]], np.array(rows[1:], np.float64)
    except (OSError, ValueError, IndexError) as error:
        raise ConfigError(f"the table {path} cannot be read: {error}") from error


@cache
def certificate(path: Path | None) -> tuple[tuple[str, ...], Spectrum]:
    """The table of a wavelength standard: its columns' names and values; without a path the synthetic one.

    Raises:
        ConfigError: It cannot be read, or has other columns.
    """
    names, values = _read(path or Path(str(files("scanhsi_sim") / "data" / "wavelength_tile.csv")))
    if names not in (["wavelength_nm", "reflectance"], ["wavelength_nm", "depth", "fwhm_nm"]) or len(values) < 2:
        raise ConfigError(
            f"{path} is no table of a wavelength standard: its columns are {', '.join(names)}.",
            hint="wavelength_nm,reflectance or wavelength_nm,depth,fwhm_nm in the first line",
        )
    return tuple(names), values[np.argsort(values[:, 0])]


def tile_reflectance(wavelength: Spectrum, path: Path | None = None) -> Spectrum:
    """Reflectance of the wavelength standard: as in its certificate, or Gaussian absorptions of a continuum of 0.9."""
    names, values = certificate(path)
    if names[1] == "reflectance":
        return np.interp(wavelength, values[:, 0], values[:, 1])
    centre, depth, fwhm = (column[:, None] for column in values.T)
    return TILE_CONTINUUM * np.prod(1 - depth * np.exp(-(((wavelength - centre) / (fwhm / FWHM)) ** 2) / 2), axis=0)


def wavelength_tile(setup: Setup) -> SpectralScene:
    """The wavelength standard, all over."""
    reflectance = tile_reflectance(wavelengths(setup), setup.target.certificate)
    return SpectralScene(setup, reflected(reflectance[:, None], setup), Everywhere())


@cache
def _checker() -> tuple[list[str], Spectrum]:
    return _read(Path(str(files("scanhsi_sim") / "data" / "colorchecker.csv")))


def patch_names() -> tuple[str, ...]:
    """The 24 patches of the colour checker, row by row."""
    return tuple(_checker()[0][1:])


def patches(wavelength: Spectrum) -> Spectrum:
    """Reflectances of the 24 patches, (bands, 24); outside 380 to 730 nm the last known value goes on."""
    _, values = _checker()
    columns: list[Spectrum] = [np.interp(wavelength, values[:, 0], column) for column in values[:, 1:].T]
    return np.stack(columns, axis=1)


def patch_centre(number: int) -> tuple[float, float]:
    """Place of a patch, 0 to 23, in mm from the centre: row by row from the upper left, which lower mirror steps see."""
    row, column = divmod(number, COLUMNS)
    return (column - (COLUMNS - 1) / 2) * PATCH_PITCH_MM, ((ROWS - 1) / 2 - row) * PATCH_PITCH_MM


def colour_checker(setup: Setup) -> SpectralScene:
    """The colour checker in its black frame."""
    wavelength = wavelengths(setup)
    frame = np.full((len(wavelength), 1), FRAME_REFLECTANCE)
    return SpectralScene(setup, reflected(np.concatenate([patches(wavelength), frame], axis=1), setup), _Checker(setup))


class _Checker:
    def __init__(self, setup: Setup) -> None:
        self._setup = setup

    def line(self, step: float, sample: int, samples: int) -> Floats:
        """Abundances (25, samples): of the patches, and of the frame between them."""
        setup, target = self._setup, self._setup.target
        foot = Footprint.at(setup.geometry, setup.optics, step, sample, samples)
        turn = np.deg2rad(target.turn_deg)
        (u, blur_u), (v, blur_v) = (foot.across(float(turn + quarter), target.centre_mm) for quarter in (0, np.pi / 2))
        shares = np.zeros((ROWS * COLUMNS + 1, samples), np.float32)
        for number in range(ROWS * COLUMNS):
            x, y = patch_centre(number)
            if np.min(np.abs(v - y)) < PATCH_MM / 2 + blur_v.reach:
                shares[number] = blur_u.stripe(u - x, PATCH_MM) * blur_v.stripe(v - y, PATCH_MM)
        shares[-1] = 1 - shares[:-1].sum(axis=0)
        return shares

"""Wavelengths that are known: lines of a lamp, absorption minima of a tile, from the package or from a table of one's own.

A table is a CSV file whose header names its columns, of which only ``wavelength_nm`` has to be there::

    wavelength_nm,intensity,species,use
    546.0750,6000,Hg I,fit

``intensity`` is relative within a species (of a tile: any measure of depth), ``use`` is ``fit`` or, for what is too weak to
calibrate with, ``identify``; lines that start with ``#`` are comments. Wavelengths are those in air: in vacuum a line at 577 nm
lies 0.16 nm higher.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices.errors import CalibrationError

_USES: Final = ("fit", "identify")
_PLAUSIBLE_NM: Final = (100.0, 20_000.0)


@dataclass(frozen=True, slots=True, eq=False)
class LineList:
    """Some wavelengths, rising.

    Attributes:
        name: Where they come from.
        wavelength_nm: In air, (line,).
        intensity: Relative within a species, (line,); 1 where unknown.
        species: ``Hg I``, (line,); empty where unknown.
        fit: Whether a line is good enough to calibrate with, (line,).
    """

    name: str
    wavelength_nm: NDArray[np.float64]
    intensity: NDArray[np.float64]
    species: tuple[str, ...]
    fit: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.wavelength_nm)

    def within(self, low_nm: float, high_nm: float) -> LineList:
        """Those between two wavelengths."""
        return self._only((self.wavelength_nm >= low_nm) & (self.wavelength_nm <= high_nm))

    def calibrating(self) -> LineList:
        """Those to calibrate with."""
        return self._only(self.fit)

    def _only(self, keep: NDArray[np.bool_]) -> LineList:
        species = tuple(name for name, kept in zip(self.species, keep.tolist(), strict=True) if kept)
        return LineList(self.name, self.wavelength_nm[keep], self.intensity[keep], species, self.fit[keep])

    def merged(self, within_nm: float) -> LineList:
        """Neighbours closer than this become one line, at their mean by intensity.

        Lines of different species are not merged: their intensities cannot be compared.
        """
        groups: list[list[int]] = []
        for index, here in enumerate(self.wavelength_nm.tolist()):
            near = groups and here - self.wavelength_nm[groups[-1][-1]] < within_nm
            if near and self.species[index] == self.species[groups[-1][-1]]:
                groups[-1].append(index)
            else:
                groups.append([index])
        means = [np.average(self.wavelength_nm[group], weights=self.intensity[group]) for group in groups]
        return LineList(
            self.name,
            np.array(means, np.float64),
            np.array([self.intensity[group].sum() for group in groups]),
            tuple(self.species[group[0]] for group in groups),
            np.array([bool(self.fit[group].any()) for group in groups]),
        )


def line_list(name: str, wavelength_nm: Iterable[float]) -> LineList:
    """A list of bare wavelengths.

    Raises:
        CalibrationError: Some are no wavelengths, or there are none.
    """
    return _build(name, [(wavelength, 1.0, "", True) for wavelength in wavelength_nm])


def hgar() -> LineList:
    """Lines of a mercury-argon lamp from 404 to 1014 nm, in air (NIST)."""
    with files("scanhsi.calibration").joinpath("data/hgar.csv").open(encoding="utf-8") as file:
        return _parse("HgAr, NIST ASD, air", file)


def load_lines(path: str | Path) -> LineList:
    """Read a table of lines, such as the certificate of a wavelength standard.

    Raises:
        CalibrationError: The file cannot be read, or a row of it is not understood; says which.
    """
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            return _parse(str(path), file)
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {error.strerror or error}.") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path} is no text file.", hint="save the table as CSV, UTF-8") from error


def _parse(name: str, rows: Iterable[str]) -> LineList:
    table = csv.DictReader(_without_comments(rows), skipinitialspace=True)
    if "wavelength_nm" not in (table.fieldnames or ()):
        raise CalibrationError(
            f"{name} has no column wavelength_nm.", hint="name the columns in its first line: wavelength_nm,intensity"
        )
    found: list[tuple[float, float, str, bool]] = []
    for number, row in enumerate(table, start=1):
        use = (row.get("use") or "fit").strip()
        if use not in _USES:
            raise CalibrationError(f"{name}, row {number}: use is {use!r}, not one of {', '.join(_USES)}.")
        try:
            values = float(row["wavelength_nm"]), float(row.get("intensity") or 1)
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"{name}, row {number}: {error}.") from error
        found.append((*values, (row.get("species") or "").strip(), use == "fit"))
    return _build(name, found)


def _without_comments(rows: Iterable[str]) -> Iterator[str]:
    return (row for row in rows if row.strip() and not row.lstrip().startswith("#"))


def _build(name: str, found: list[tuple[float, float, str, bool]]) -> LineList:
    if not found:
        raise CalibrationError(f"{name} holds no line.")
    for wavelength, intensity, _, _ in found:
        if not _PLAUSIBLE_NM[0] <= wavelength <= _PLAUSIBLE_NM[1]:
            raise CalibrationError(f"{name}: {wavelength:g} is no wavelength in nm.", hint="micrometres, or angstroms?")
        if not (intensity > 0 and math.isfinite(intensity)):
            raise CalibrationError(f"{name}: the line at {wavelength:g} nm has intensity {intensity:g}.")
    found = sorted(found)
    wavelengths, intensities, species, fit = zip(*found, strict=True)
    if len(set(wavelengths)) < len(wavelengths):
        raise CalibrationError(f"{name} holds a line twice.")
    return LineList(name, np.array(wavelengths), np.array(intensities), species, np.array(fit))

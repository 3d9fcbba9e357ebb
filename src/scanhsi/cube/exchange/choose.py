"""Which bands and lines: ``450nm:700nm,12,803nm`` and ``10:200``."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.devices.errors import ConfigError

_PLACE = re.compile(r"(?P<number>\d+(\.\d+)?)\s*(?P<nm>nm)?")


def choose_bands(dataset: xr.Dataset, bands: str | Sequence[int] | None) -> NDArray[np.intp]:
    """Indices of the bands wanted, in the order wanted.

    Args:
        dataset: Of `open_cube`.
        bands: Indices; or text: bands and ranges with commas between. A band is an index (``12``) or the one nearest to a
            wavelength (``803nm``). A range of indices (``10:20``) leaves its end out, one of wavelengths (``450nm:700nm``) has
            both ends in. None: all.

    Raises:
        ConfigError: No such bands, or wavelengths of a cube that has none.
    """
    count = dataset.sizes["band"]
    if bands is None:
        return np.arange(count)
    if isinstance(bands, str):
        pieces = [_choose(dataset, piece.strip()) for piece in bands.split(",")]
        chosen = np.concatenate(pieces)
    else:
        chosen = np.asarray(bands, np.intp)
    if not chosen.size:
        raise ConfigError(f"bands {bands!r} are none of the {count} bands.")
    if chosen.min() < 0 or chosen.max() >= count:
        raise ConfigError(f"bands {bands!r}: the cube has bands 0 to {count - 1}.")
    if np.unique(chosen).size != chosen.size:
        raise ConfigError(f"bands {bands!r} name a band twice.")
    return chosen


def _choose(dataset: xr.Dataset, text: str) -> NDArray[np.intp]:
    places = [_place(part, text) for part in text.split(":")]
    if len(places) > 2:
        raise ConfigError(f"bands {text!r}: a range has two ends.")
    if len({unit for _, unit in places}) > 1:
        raise ConfigError(f"bands {text!r}: both ends of a range are indices, or both are in nm.")
    if places[0][1]:
        return _near(_wavelengths(dataset, text), [number for number, _ in places])
    indices = [_index(number, text) for number, _ in places]
    return np.arange(indices[0], indices[-1] + (len(indices) == 1))


def _place(text: str, whole: str) -> tuple[float, bool]:
    """A number, and whether it is in nm."""
    match = _PLACE.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"bands {whole!r}: {text!r} is neither an index (12) nor a wavelength (803nm).")
    return float(match["number"]), match["nm"] is not None


def _index(number: float, text: str) -> int:
    if number != int(number):
        raise ConfigError(f"bands {text!r}: an index is a whole number; wavelengths end in nm.")
    return int(number)


def _wavelengths(dataset: xr.Dataset, text: str) -> NDArray[np.float64]:
    if "wavelength" not in dataset.variables:
        raise ConfigError(f"bands {text!r}: the cube has no wavelengths.", hint="bands by their index")
    return np.asarray(dataset["wavelength"].values, np.float64)


def _near(wavelength_nm: NDArray[np.float64], places: list[float]) -> NDArray[np.intp]:
    if len(places) == 1:
        return np.array([np.abs(wavelength_nm - places[0]).argmin()])
    return np.flatnonzero((wavelength_nm >= min(places)) & (wavelength_nm <= max(places)))


def parse_lines(text: str | None) -> slice:
    """Lines from text: ``10:200``, ``10:``, ``:200``, ``-100:``; the end is left out. None: all.

    Raises:
        ConfigError: It is no such range.
    """
    match = re.fullmatch(r"\s*(-?\d+)?\s*:\s*(-?\d+)?\s*", ":" if text is None else text)
    if match is None:
        raise ConfigError(f"lines {text!r}: a range is written as first:end, either may be left out.")
    first, end = (None if number is None else int(number) for number in match.groups())
    return slice(first, end)

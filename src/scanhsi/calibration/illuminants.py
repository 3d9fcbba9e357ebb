"""The light that colours are seen under: CIE illuminants and lamps by name, a glowing body by its temperature, or a table.

Power is relative; between the lines of a table it is linear, outside of it there is none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanhsi.devices.errors import ConfigError

Floats = NDArray[np.float64]

_SECOND_RADIATION_NM_K: Final = 1.438777e7  # CODATA 2018
_KELVIN: Final = re.compile(r"(\d+(?:\.\d+)?)\s*K", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Illuminant:
    """A light.

    Attributes:
        name: What it is called.
        wavelength_nm: (n,), ascending.
        power: Relative, (n,).
    """

    name: str
    wavelength_nm: Floats
    power: Floats

    def at(self, wavelength_nm: ArrayLike) -> Floats:
        """Power at some wavelengths."""
        return np.interp(np.asarray(wavelength_nm, np.float64), self.wavelength_nm, self.power, left=0.0, right=0.0)


@cache
def _table() -> dict[str, Floats]:
    with files("scanhsi.calibration").joinpath("data/illuminants.csv").open() as file:
        lines = [line for line in file.read().splitlines() if not line.startswith("#")]
    return dict(zip(lines[0].split(","), np.loadtxt(lines[1:], delimiter=",", unpack=True), strict=True))


def names() -> tuple[str, ...]:
    """Lights known by name."""
    return (*(name for name in _table() if name != "wavelength_nm"), "E")


def illuminant(name: str) -> Illuminant:
    """A light by name.

    Args:
        name: One of `names` (``D65``, ``A``, ``FL11``; ``E`` has the same power everywhere), the temperature of a glowing body
            (``3200 K``), or a CSV file of wavelength in nm and power, with or without a heading.

    Raises:
        ConfigError: None of these.
    """
    table = _table()
    known = {key.lower(): key for key in names()}.get(name.strip().lower())
    nm = table["wavelength_nm"]
    if known == "E":
        return Illuminant("E", nm, np.ones_like(nm))
    if known is not None:
        return Illuminant(known, nm, table[known])
    if glowing := _KELVIN.fullmatch(name.strip()):
        return _planck(float(glowing[1]))
    if name.lower().endswith(".csv"):
        return _load(Path(name))
    raise ConfigError(
        f"there is no light {name!r}; there are: {', '.join(names())}.", hint='a temperature ("3200 K"), or a CSV file'
    )


def _planck(kelvin: float) -> Illuminant:
    if not 500 <= kelvin <= 100_000:
        raise ConfigError(f"a body of {kelvin:g} K is no light to see by: 500 to 100000 K.")
    nm: Floats = np.arange(300.0, 831.0)
    power = (560 / nm) ** 5 * np.expm1(_SECOND_RADIATION_NM_K / (560 * kelvin))
    return Illuminant(f"{kelvin:g} K", nm, power / np.expm1(_SECOND_RADIATION_NM_K / (nm * kelvin)))


def _load(path: Path) -> Illuminant:
    try:
        lines = [line for line in path.read_text("utf-8").splitlines() if line.strip() and not line.startswith("#")]
        rows = lines if lines and lines[0].lstrip()[0].isdigit() else lines[1:]
        columns = np.array([[float(cell) for cell in row.split(",")[:2]] for row in rows]).T
        nm, power = columns[:, np.argsort(columns[0])]
    except (OSError, ValueError, IndexError) as error:
        raise ConfigError(f"{path} is no table of a light: {error}.", hint="two columns: nm, power") from error
    seen = (nm > 380) & (nm < 780)
    if seen.sum() < 2 or not np.isfinite(power).all() or (power < 0).any() or not power[seen].any():
        raise ConfigError(f"{path} is no table of a light: two rows between 380 and 780 nm at least, none below 0.")
    return Illuminant(path.name, nm, power)

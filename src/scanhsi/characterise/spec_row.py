"""A row of the specification sheet, and how its numbers are written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    Attributes:
        key: Names it in ``spec.json``.
        title: In words.
        value: With its unit.
        uncertainty: One standard error, with its unit; empty where none is known.
        number: The value as a number, for programs; None where it is none.
        unit: Of ``number``.
        source: File of the result, or what else it comes from; empty where nothing was measured.
        identity: Of the result, whatever its file is called; see `scanhsi.calibration.result.identity`.
        taken: When it was measured, ISO 8601.
        simulated: Whether it is of a simulated instrument; None where that is not known.
        paper: What the paper's table says of its instrument.
    """

    key: str
    title: str
    value: str
    uncertainty: str = ""
    number: float | None = None
    unit: str = ""
    source: str = ""
    identity: str = ""
    taken: str = ""
    simulated: bool | None = None
    paper: str = ""


@dataclass(frozen=True, slots=True)
class Timing:
    """Efficiency in one mode, from the records of the bench.

    Attributes:
        mode, pixel_format, exposure_s: Of the scan.
        efficiency, sigma: Exposure over line period, with its standard error.
        lines: Line periods measured.
        source: File of the records.
        taken: When, ISO 8601.
        simulated: Whether the instrument was.
    """

    mode: str
    pixel_format: str
    exposure_s: float
    efficiency: float
    sigma: float
    lines: int
    source: str
    taken: str
    simulated: bool


class Make(Protocol):
    """Makes a row of a number; the result behind it is known."""

    def __call__(self, key: str, title: str, number: float, unit: str, sigma: float = math.nan, text: str = "") -> Row:
        """Args: title, empty where Table 7 has one; sigma, standard error; text, instead of number and unit."""
        ...


def shown(number: float, unit: str, sigma: float) -> str:
    """A number with as many digits as its uncertainty deserves, four without one."""
    if not math.isfinite(number):
        return "not found"
    if math.isfinite(sigma) and sigma > 0:
        digits = max(0, 1 - math.floor(math.log10(sigma)))
        return f"{number:.{min(digits, 9)}f} {unit}".strip()
    return f"{number:.0f} {unit}".strip() if abs(number) >= 1000 else f"{number:.4g} {unit}".strip()


def part(flags: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> str:
    """How many of how many."""
    return f"{int(flags.sum())} of {flags.size} ({100 * float(flags.mean()):.3g} %)"

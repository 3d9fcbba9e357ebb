"""What is imported: another program's cube, read a few lines at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True, eq=False)
class Incoming:
    """A cube of another program.

    Attributes:
        path: The file that was named.
        format: ``ENVI``, ``OpenHSI NetCDF``, ``scanhsi NetCDF``.
        shape: (bands, lines, samples).
        dtype: Of a pixel in the file.
        read: (first line, line after the last) -> pixels (line, band, sample).
        close: Lets go of the file.
        header: What the file says of itself, plain JSON.
        wavelength_nm: (bands,), where known.
        fwhm_nm: (bands,), where known.
        significant_bits: Of a pixel, where known.
        missing: Line -> why there are no pixels.
        ignore: Lines in which every pixel has this value are missing.
        simulated: Where the file says so.
        quantity: What a pixel is, in words.
        units: Of a pixel.
        columns: Records of the lines by the names of the cube, int64 ns for times; ``time`` is wall clock.
        notes: What the user should know.
    """

    path: Path
    format: str
    shape: tuple[int, int, int]
    dtype: np.dtype[Any]
    read: Callable[[int, int], NDArray[Any]]
    close: Callable[[], None]
    header: Mapping[str, Any]
    wavelength_nm: NDArray[np.float64] | None = None
    fwhm_nm: NDArray[np.float64] | None = None
    significant_bits: int | None = None
    missing: dict[int, str] = field(default_factory=dict[int, str])
    ignore: float | None = None
    simulated: bool | None = None
    quantity: str | None = None
    units: str | None = None
    columns: dict[str, NDArray[Any]] = field(default_factory=dict[str, NDArray[Any]])
    notes: list[str] = field(default_factory=list[str])

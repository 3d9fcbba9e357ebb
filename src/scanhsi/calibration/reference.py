"""Dark and white references: the mean line of a cube."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.conditions import Conditions
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CalibrationError

_BLOCK_BYTES = 32_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The mean line of a reference cube.

    Attributes:
        source: The cube it was made from.
        mean: (band, sample) float32, counts; nan where a pixel was saturated in any line.
        lines: Number of lines averaged.
        conditions: Under which it was taken.
    """

    source: str
    mean: NDArray[np.float32]
    lines: int
    conditions: Conditions

    def describe(self) -> dict[str, Any]:
        """What provenance says of it."""
        return {"source": self.source, "lines": self.lines, "exposure_s": self.conditions.exposure_s}


def average(path: str | Path) -> Reference:
    """Average the stored lines of a cube of raw counts, in one pass and bounded memory.

    Raises:
        NotACube, CubeError: It cannot be read.
        CalibrationError: It holds no line.
    """
    dataset = open_cube(path, chunks=None)
    cube = dataset["cube"]
    saturation = cube.attrs.get("valid_max")
    stored = np.flatnonzero(np.asarray(dataset["status"].values) == LineStatus.STORED)
    if not stored.size:
        raise CalibrationError(f"{path} holds no line to average.")
    total = np.zeros((dataset.sizes["band"], dataset.sizes["sample"]))
    saturated = np.zeros(total.shape, bool)
    step = max(1, _BLOCK_BYTES // (total.size * cube.dtype.itemsize))
    for lines in np.split(stored, range(step, stored.size, step)):
        block = np.asarray(cube.isel(line=lines).values)
        total += block.sum(axis=1, dtype=np.float64)
        if saturation is not None:
            saturated |= (block >= saturation).any(axis=1)
    mean = (total / stored.size).astype(np.float32)
    mean[saturated] = np.nan
    return Reference(str(path), mean, int(stored.size), Conditions.of(dataset.attrs))

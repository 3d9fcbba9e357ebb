"""The frames of a reference cube, one block of lines at a time: mean, noise and saturation in constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.saturation import Histogram
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_BLOCK_BYTES: Final = 16_000_000


@dataclass(frozen=True, slots=True, eq=False)
class FrameStack:
    """What the lines of a cube come to, taken as repeated frames of one thing.

    Attributes:
        source: The cube.
        mean: (band, sample) counts.
        sigma: Standard deviation over the lines, (band, sample) counts; nan of a single line.
        saturated: Pixels that were saturated in any line, (band, sample).
        level: Counts from which a pixel is saturated; None where that is not known.
        lines: Lines used.
        conditions: Under which it was taken.
    """

    source: str
    mean: Floats
    sigma: Floats
    saturated: NDArray[np.bool_]
    level: float | None
    lines: int
    conditions: Conditions


def stored_lines(dataset: xr.Dataset, name: str) -> NDArray[np.intp]:
    """Indices of the lines that are there.

    Raises:
        CalibrationError: None is, or the cube holds no raw counts.
    """
    if dataset["cube"].dtype.kind != "u":
        raise CalibrationError(f"{name} holds no raw counts.", hint="take the cube as it was scanned")
    stored = np.flatnonzero(np.asarray(dataset["status"].values) == LineStatus.STORED)
    if not stored.size:
        raise CalibrationError(f"{name} holds no line.")
    return stored


def frames_of(dataset: xr.Dataset, name: str) -> Iterator[NDArray[Any]]:
    """The stored lines of a raw cube as frames, (band, sample), read some at a time.

    Args:
        dataset: Of `scanhsi.open_cube`, without dask.
        name: Of the cube in messages.

    Raises:
        CalibrationError: It holds no line, or no raw counts.
    """
    for block in _blocks(dataset, name):
        for line in range(block.shape[1]):
            yield block[:, line]


def _blocks(dataset: xr.Dataset, name: str) -> Iterator[NDArray[Any]]:
    cube, stored = dataset["cube"], stored_lines(dataset, name)
    step = max(1, _BLOCK_BYTES // (dataset.sizes["band"] * dataset.sizes["sample"] * cube.dtype.itemsize))
    for lines in np.split(stored, range(step, stored.size, step)):
        yield np.asarray(cube.isel(line=lines).values)


def stack_frames(path: str | Path, *, saturation: float | None = None) -> FrameStack:
    """Average the lines of a cube of raw counts, in one pass.

    Args:
        path: The cube.
        saturation: Counts from which a pixel is saturated. None: the plateau that the counts show, else the largest valid value.

    Raises:
        NotACube, CubeError: It cannot be read.
        CalibrationError: It holds no line, or no raw counts.
    """
    dataset = open_cube(path, chunks=None)
    full_scale = dataset["cube"].attrs.get("valid_max")
    shape = dataset.sizes["band"], dataset.sizes["sample"]
    total, squares, peak = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    first: Floats | None = None
    histogram = Histogram(int(full_scale)) if full_scale is not None and full_scale < 1 << 17 else None
    lines = 0
    for block in _blocks(dataset, str(path)):
        if first is None:
            first = block[:, 0].astype(np.float64)  # sums of squares around it lose no digits
        for line in range(block.shape[1]):
            difference = block[:, line] - first
            total += difference
            squares += difference**2
        np.maximum(peak, block.max(axis=1), out=peak)
        lines += block.shape[1]
        if histogram is not None and saturation is None:
            histogram.add(block)
    assert first is not None, "stored_lines refuses cubes without lines"
    level = saturation
    if level is None:
        plateau = histogram.plateau() if histogram is not None else None
        level = plateau if plateau is not None else full_scale
    variance = (squares - total**2 / lines) / (lines - 1) if lines > 1 else np.full(shape, np.nan)
    return FrameStack(
        source=str(path),
        mean=first + total / lines,
        sigma=np.sqrt(np.maximum(variance, 0)),
        saturated=np.zeros(shape, bool) if level is None else peak >= level,
        level=level,
        lines=lines,
        conditions=Conditions.of(dataset.attrs),
    )

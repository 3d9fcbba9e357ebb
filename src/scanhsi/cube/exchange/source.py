"""What is exported: the chosen lines and bands of a cube, read a block at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CubeError

BLOCK_BYTES: Final = 48_000_000
"""Pixels read at once, more or less: a shard at least."""

Told = Callable[[int, int], None]
"""Is told how many of how many bytes of pixels are done."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Lines and bands of one cube.

    Attributes:
        path: Of the cube, or its URL.
        dataset: As `open_cube` has it, but only the chosen lines and bands, and what goes along one axis.
        pixels: The whole cube array, (band, line, sample).
        lines: Chosen lines, (first, end).
        bands: Chosen bands, indices in the cube.
        told: Told of the progress.
        notes: What the reader of the export should know; formats add what they cannot carry.
    """

    path: str
    dataset: xr.Dataset
    pixels: xr.DataArray
    lines: tuple[int, int]
    bands: NDArray[np.intp]
    told: Told | None = None
    notes: list[str] = field(default_factory=list[str])

    @property
    def name(self) -> str:
        """Of the cube, without its folder."""
        return self.path.rstrip("/").rsplit("/", 1)[-1]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(bands, lines, samples)."""
        return (len(self.bands), self.lines[1] - self.lines[0], self.pixels.shape[2])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of a pixel, in the byte order of this computer."""
        return np.dtype(self.pixels.dtype).newbyteorder("=")

    @property
    def nbytes(self) -> int:
        """Size of all chosen pixels."""
        return int(np.prod(self.shape)) * self.dtype.itemsize

    @property
    def status(self) -> NDArray[np.uint8]:
        """`LineStatus` of each line."""
        return np.asarray(self.dataset["status"].values, np.uint8)

    @property
    def missing(self) -> NDArray[np.bool_]:
        """(lines,): where there are no pixels."""
        return self.status != LineStatus.STORED

    @property
    def saturation(self) -> int | None:
        """Pixels of this value are saturated; None where nothing saturates (reflectance, radiance)."""
        top = self.pixels.attrs.get("valid_max")
        return top if isinstance(top, int) and self.dtype.kind == "u" else None

    @property
    def significant_bits(self) -> int | None:
        """Of a pixel."""
        bits = self.pixels.attrs.get("significant_bits")
        return bits if isinstance(bits, int) and self.dtype.kind == "u" else None

    @property
    def filler(self) -> int | float:
        """Stands for lines that are missing, where a format has one value for "no data": that of saturated pixels, or nan.

        So one value marks both, and no pixel that was stored is changed.
        """
        return np.nan if self.saturation is None else self.saturation

    @property
    def simulated(self) -> bool | None:
        """Whether the cube is; None where it does not say."""
        simulated = self.dataset.attrs.get("simulated")
        return simulated if isinstance(simulated, bool) else None

    @property
    def units(self) -> str:
        """Of a pixel."""
        return str(self.pixels.attrs.get("units", "1"))

    @property
    def quantity(self) -> str:
        """What a pixel is, in words."""
        return str(self.pixels.attrs.get("long_name", "raw camera counts"))

    @property
    def wavelength_nm(self) -> NDArray[np.float64] | None:
        """(bands,), where calibrated."""
        return self._per_band("wavelength")

    @property
    def fwhm_nm(self) -> NDArray[np.float64] | None:
        """(bands,), where known."""
        return self._per_band("fwhm")

    def _per_band(self, name: str) -> NDArray[np.float64] | None:
        if name in self.dataset.variables:
            return np.asarray(self.dataset[name].values, np.float64)
        listed = self.dataset.attrs.get(f"{name}_nm")  # imported cubes
        whole = np.asarray(listed if isinstance(listed, list) else [], np.float64)
        return whole[self.bands] if whole.shape == (self.pixels.shape[0],) else None

    @property
    def summary(self) -> str:
        """The cube in one line, for titles."""
        bands, lines, samples = self.shape
        lost = int(self.missing.sum())
        text = f"{self.name}: {self.quantity}, {bands} bands x {lines} lines x {samples} samples"
        return ("SIMULATED " if self.simulated else "") + text + (f", {lost} lines missing" if lost else "")

    @property
    def chunk(self) -> tuple[int, int, int]:
        """What is compressed at once, not larger than what was chosen."""
        bands, lines, samples = self._pieces("chunks")
        return min(bands, self.shape[0]), min(lines, self.shape[1]), min(samples, self.shape[2])

    def _pieces(self, of: str) -> tuple[int, int, int]:
        """Shape of what is read (``chunks``) or was written (``shards``) at once."""
        return self.pixels.encoding.get(of) or self.pixels.encoding.get("chunks") or self.shape

    def blocks(self, fill: float | None = None) -> Iterator[tuple[int, NDArray[Any]]]:
        """The pixels by lines: whole shards, in order.

        Args:
            fill: Put in place of missing lines, which are 0 otherwise.

        Yields:
            (First line, counted from the first chosen one; pixels (band, line, sample)).
        """
        bands, _, samples = self.shape
        shard = self._pieces("shards")[1]
        step = shard * max(1, BLOCK_BYTES // max(1, bands * samples * self.dtype.itemsize * shard))
        first, end = self.lines
        start = first
        while start < end:
            stop = min((start // step + 1) * step, end)
            yield start - first, self._read(self.bands, slice(start, stop), slice(None), fill)
            self._tell(stop - first, end - first)
            start = stop

    def columns(self) -> Iterator[NDArray[Any]]:
        """The pixels by bands: (band, line, sample), all lines of some neighbouring bands and samples, in their order.

        Where a band does not fit into a block it comes in several, by samples.
        """
        bands, lines, samples = self.shape
        plane = lines * samples * self.dtype.itemsize
        together = max(1, min(self._pieces("chunks")[0], BLOCK_BYTES // plane)) if plane else 1
        width = max(1, BLOCK_BYTES // (lines * self.dtype.itemsize)) if plane > BLOCK_BYTES else samples
        start = 0
        while start < bands:
            stop = min((start // together + 1) * together, bands)
            for left in range(0, samples, width):
                yield self._read(self.bands[start:stop], slice(*self.lines), slice(left, left + width), None)
            self._tell(stop, bands)
            start = stop

    def _read(self, bands: NDArray[np.intp], lines: slice, samples: slice, fill: float | None) -> NDArray[Any]:
        first, last = int(bands[0]), int(bands[-1])
        neighbours = np.array_equal(bands, np.arange(first, last + 1))
        chosen = self.pixels.isel(band=slice(first, last + 1) if neighbours else bands, line=lines, sample=samples)
        pixels = chosen.to_numpy().astype(self.dtype, copy=False)
        if fill is not None:
            pixels[:, self.missing[lines.start - self.lines[0] : lines.stop - self.lines[0]]] = fill
        return pixels

    def _tell(self, done: int, total: int) -> None:
        if self.told is not None:
            self.told(self.nbytes * done // total, self.nbytes)


def open_source(
    path: str | Path, lines: slice, choose_bands: Callable[[xr.Dataset], NDArray[np.intp]], told: Told | None
) -> Source:
    """Open a cube for export.

    Args:
        path: The cube.
        lines: Of the cube; negative numbers count from its end.
        choose_bands: Indices of the bands wanted, from the whole dataset.
        told: Told of the progress.

    Raises:
        NotACube, CubeError: As `open_cube`; or no line is chosen, or the cube holds none.
    """
    dataset = open_cube(path, chunks=None)
    reached = dataset.sizes["line"]
    first, end, _ = lines.indices(reached)
    if reached == 0:
        raise CubeError(f"{path} holds no line yet: there is nothing to export.")
    if end <= first:
        raise CubeError(f"{path} has lines 0 to {reached - 1}; none of them was chosen.")
    bands = choose_bands(dataset)
    wide = [name for name, value in dataset.variables.items() if value.ndim != 1]
    chosen = dataset.drop_vars(wide).isel(line=slice(first, end), band=bands).load()
    source = Source(str(path), chosen, dataset["cube"], (first, end), bands, told)
    source.notes.extend(_notes(source, reached, int(dataset.attrs.get("lines_planned", reached))))
    return source


def _notes(source: Source, reached: int, planned: int) -> Iterator[str]:
    if reached < planned:
        yield f"the cube is partial: {reached} of {planned} planned lines were reached"
    if lost := int(source.missing.sum()):
        yield f"{lost} of {len(source.missing)} lines are missing"
    if source.simulated:
        yield "the cube is simulated, not measured"

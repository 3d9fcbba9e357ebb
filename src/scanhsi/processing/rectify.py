"""From lines and samples to millimetres: a cube on an even grid in the object plane (Eqs. 5-13).

The further from the normal, the further apart are a mirror's lines (as the square of 1 / cos of the angle), and the longer is each
line (as 1 / cos): the samples' pitch changes from line to line, which no affine map undoes, whatever the paper says. Lines are
resampled first, along y, then each new line along x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from scanhsi.calibration.geometry import Geometry
from scanhsi.cube.conventions import X_ATTRIBUTES, Y_ATTRIBUTES
from scanhsi.cube.layout import Coordinate, CubeSpec, choose_layout
from scanhsi.cube.records import LineStatus
from scanhsi.cube.rewrite import Progress, Rewriting, attributes_of, open_source
from scanhsi.cube.shards import Codec
from scanhsi.devices.errors import CalibrationError
from scanhsi.processing.grid import Floats, cell_means, cell_weights

if TYPE_CHECKING:
    from distributed import Client

_STEEPEST_RAD: Final = math.radians(60)
_GAP: Final = 1.5  # of the usual distance of lines, in steps: beyond, a line is missing between
_LINES_AT_ONCE: Final = 16
_BLOCK_BYTES: Final = 48_000_000  # of lines that are taken in
_LARGEST: Final = 100_000  # lines or samples of a grid


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """An even grid in the object plane.

    Attributes:
        x_mm: Middles of its samples, rising, (sample,).
        y_mm: Middles of its lines, in the direction of the scan, (line,).
    """

    x_mm: Floats
    y_mm: Floats

    @classmethod
    def covering(
        cls, geometry: Geometry, steps: Floats, samples: int, pitch_mm: float | tuple[float, float] | None
    ) -> Self:
        """The grid that holds all that was seen.

        Args:
            geometry: Where lines and samples lie.
            steps: Of the lines, (line,).
            samples: Of a line.
            pitch_mm: Of the grid, along y and x if they differ; None keeps the distances that lines and samples have at the
                normal.

        Raises:
            CalibrationError: The grid would be none, or too large.
        """
        y = geometry.y_mm(steps)
        x = geometry.x_mm(np.array([[0.0], [samples - 1.0]]), steps)
        step = float(np.median(np.abs(np.diff(steps))))
        own = (step * float(geometry.line_pitch_mm(geometry.normal_step)), abs(geometry.sample_pitch_mm))
        along_y, along_x = (
            own if pitch_mm is None else (pitch_mm, pitch_mm) if isinstance(pitch_mm, float | int) else pitch_mm
        )
        forward = 1 if y[-1] >= y[0] else -1
        return cls(
            x_mm=_even(float(x.min()), float(x.max()), along_x),
            y_mm=_even(float(y.min()), float(y.max()), along_y)[::forward],
        )

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Along y and x."""
        return abs(float(self.y_mm[1] - self.y_mm[0])), float(self.x_mm[1] - self.x_mm[0])


def _even(low: float, high: float, pitch: float) -> Floats:
    if not (pitch > 0 and math.isfinite(pitch)):
        raise CalibrationError(f"a grid cannot have a pitch of {pitch:g} mm.")
    count = math.floor((high - low) / pitch)
    if not 2 <= count <= _LARGEST:
        raise CalibrationError(
            f"{high - low:.1f} mm at {pitch:g} mm make a grid of {count}; 2 to {_LARGEST} can be.",
            hint="another pitch, in mm",
        )
    first = (low + high) / 2 - (count - 1) / 2 * pitch
    return first + pitch * np.arange(count, dtype=np.float64)


class _Rectified(BackendArray):
    """The rectified pixels, computed where they are asked for; threads may share it."""

    def __init__(
        self, cube: xr.DataArray, geometry: Geometry, grid: Grid, steps: Floats, lines: NDArray[np.intp]
    ) -> None:
        self.shape = (cube.sizes["band"], len(grid.y_mm), len(grid.x_mm))
        self.dtype = np.dtype(np.float32)
        self._cube, self._geometry, self._grid = cube, geometry, grid
        self._lines = lines
        self._saturation: Any = cube.attrs.get("valid_max") if cube.dtype.kind == "u" else None
        self._weights = _line_weights(geometry, grid, steps)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[int | slice, ...]) -> NDArray[Any]:
        bands, lines, samples = key
        wanted = np.atleast_1d(np.arange(self.shape[1])[lines])
        chosen = np.atleast_1d(np.arange(self.shape[0])[bands])
        out = np.full((len(chosen), len(wanted), self.shape[2]), np.nan, np.float32)
        for first in range(0, len(wanted), _LINES_AT_ONCE):
            some = slice(first, first + _LINES_AT_ONCE)
            for part in self._band_parts(len(chosen), wanted[some]):
                out[part, some] = self._rectify(chosen[part], wanted[some])
        return out[0 if isinstance(bands, int) else slice(None), 0 if isinstance(lines, int) else slice(None)][
            ..., samples
        ]

    def _band_parts(self, bands: int, wanted: NDArray[np.intp]) -> list[slice]:
        """So many bands at a time that what a coarse grid takes in does not fill the memory."""
        taken_in = max(1, int(np.count_nonzero((self._weights[wanted] > 0).any(axis=0))))
        at_once = max(1, _BLOCK_BYTES // (taken_in * self._cube.sizes["sample"] * 4))
        return [slice(first, first + at_once) for first in range(0, bands, at_once)]

    def _rectify(self, bands: NDArray[np.intp], wanted: NDArray[np.intp]) -> NDArray[np.float32]:
        """Some new lines, (band, line, sample)."""
        weights = self._weights[wanted]
        used = np.flatnonzero((weights > 0).any(axis=0))
        known = ~np.isnan(weights).any(axis=1)
        out = np.full((len(bands), len(wanted), self.shape[2]), np.nan, np.float32)
        if not used.size:
            return out
        window = slice(int(used[0]), int(used[-1]) + 1)
        values = self._values(bands, self._lines[window])
        edges_mm = np.append(
            self._grid.x_mm - self._grid.pitch_mm[1] / 2, self._grid.x_mm[-1] + self._grid.pitch_mm[1] / 2
        )
        for index in np.flatnonzero(known).tolist():
            line = _mean_line(values, weights[index, window])
            step = self._geometry.step_of(self._grid.y_mm[wanted[index]])
            edges = self._geometry.sample_of(edges_mm, step)
            turned = edges[0] > edges[-1]
            means = cell_means(line, edges[::-1] if turned else edges)
            out[:, index] = means[:, ::-1] if turned else means
        return out

    def _values(self, bands: NDArray[np.intp], lines: NDArray[np.intp]) -> NDArray[np.float32]:
        """Lines of the cube, (band, line, sample); saturated counts are nan."""
        block = slice(int(lines.min()), int(lines.max()) + 1)
        near = slice(int(bands.min()), int(bands.max()) + 1)
        raw = np.asarray(self._cube.isel(band=near, line=block).values)[:, lines - block.start][bands - near.start]
        values = raw.astype(np.float32)
        if self._saturation is not None:
            values[raw >= self._saturation] = np.nan
        return values


def _mean_line(values: NDArray[np.float32], weights: Floats) -> NDArray[np.float32]:
    """Weighted mean over the lines, (band, sample); lines without weight may be nan."""
    counted = np.flatnonzero(weights)
    return np.einsum("bls,l->bs", values[:, counted], weights[counted].astype(np.float32))


def _line_weights(geometry: Geometry, grid: Grid, steps: Floats) -> Floats:
    """Of the lines taken in the lines of the grid, (line of the grid, line); nan rows where a line is missing between."""
    y = geometry.y_mm(steps)
    rising = np.argsort(y, kind="stable")
    half = grid.pitch_mm[0] / 2
    up = np.sort(grid.y_mm)
    weights = cell_weights(y[rising], np.append(up - half, up[-1] + half))
    apart = np.abs(np.diff(steps[rising]))
    holes = np.flatnonzero(apart > _GAP * np.median(apart))
    for hole in holes.tolist():
        low, high = y[rising][hole], y[rising][hole + 1]
        weights[(up + half > low) & (up - half < high)] = np.nan
    back = np.empty_like(weights)
    back[:, rising] = weights
    return back if grid.y_mm[-1] >= grid.y_mm[0] else back[::-1]


def rectified(
    dataset: xr.Dataset, geometry: Geometry, *, pitch_mm: float | tuple[float, float] | None = None
) -> xr.Dataset:
    """A cube on an even grid in the object plane, lazily: pixels are computed as they are asked for.

    Pixels are means over the cells of the grid, so that the sum over the area stays; nan where not known: beyond what was seen,
    at missing lines, and where a saturated count, or nan, takes part. What is known of a line is taken from the nearest one.

    Args:
        dataset: Of `scanhsi.open_cube`, best with ``chunks=None``.
        geometry: Of the same instrument and object plane.
        pitch_mm: Of the grid, one number for square pixels, or along y and x; None keeps those at the normal.

    Returns:
        As `scanhsi.open_cube`, float32, with coordinates ``x`` (sample) and ``y`` (line) in mm.

    Raises:
        CalibrationError: The mirror's steps are not known, lie in one place or beyond 60 degrees, or make no grid.
    """
    steps, lines = _placed(dataset, geometry)
    grid = Grid.covering(geometry, steps, dataset.sizes["sample"], pitch_mm)
    cube = dataset["cube"]
    pixels: Any = indexing.LazilyIndexedArray(_Rectified(cube, geometry, grid, steps, lines))
    y = geometry.y_mm(steps)
    nearest = lines[np.abs(grid.y_mm[:, None] - y[None, :]).argmin(axis=1)]
    attributes = {key: value for key, value in cube.attrs.items() if key in ("long_name", "units")}
    made = xr.Dataset(
        {"cube": (("band", "line", "sample"), pixels, attributes)}, attrs=_attributes(dataset, geometry, grid)
    )
    records = {
        str(name): ("line", np.asarray(array.values)[nearest], array.attrs)
        for name, array in dataset.variables.items()
        if array.dims == ("line",) and name not in ("line", "y")
    }
    same = {name: dataset[name] for name in ("band", "wavelength") if name in dataset.coords}
    places: dict[str, Any] = {"x": ("sample", grid.x_mm, X_ATTRIBUTES), "y": ("line", grid.y_mm, Y_ATTRIBUTES)}
    return made.assign_coords({**same, **records, **places, "line": np.arange(len(grid.y_mm))})


def _placed(dataset: xr.Dataset, geometry: Geometry) -> tuple[Floats, NDArray[np.intp]]:
    """Steps of the lines that are stored, and these lines."""
    if "mirror_step" not in dataset.variables:
        raise CalibrationError("the cube does not say where the mirror was: it cannot be rectified.")
    lines = np.flatnonzero(np.asarray(dataset["status"].values) == LineStatus.STORED)
    steps = np.asarray(dataset["mirror_step"].values, np.float64)[lines]
    if len(np.unique(steps)) < 3:
        raise CalibrationError(f"the lines lie at {len(np.unique(steps))} steps of the mirror: nothing to rectify.")
    _, first = np.unique(steps, return_index=True)
    order = np.sort(first)  # of lines at one step, the first
    steps, lines = steps[order], lines[order]
    far = float(np.abs(geometry.gamma_rad(steps)).max())
    if far >= _STEEPEST_RAD:
        raise CalibrationError(
            f"lines lie up to {math.degrees(far):.0f} degrees from the normal; a plane can be made of 60 at most.",
            hint="is it the geometry of this instrument, and its step 0 the same?",
        )
    return steps, lines


def _attributes(dataset: xr.Dataset, geometry: Geometry, grid: Grid) -> dict[str, Any]:
    step = {
        "step": "rectify",
        "source": list(geometry.provenance.sources),
        "distance_mm": geometry.distance_mm,
        "normal_step": geometry.normal_step,
        "tilt_rad": geometry.tilt_rad,
        "pitch_mm": list(grid.pitch_mm),
    }
    return {**dataset.attrs, "processing": [*dataset.attrs.get("processing", []), step], "missing": {}}


def rectify(
    cube: str | Path,
    output: str | Path,
    geometry: Geometry,
    *,
    pitch_mm: float | tuple[float, float] | None = None,
    client: Client | None = None,
    threads: int = 2,
    codec: Codec = "lz4",
    resume: bool = False,
    progress: Progress | None = None,
    storage_options: Mapping[str, str] | None = None,
) -> Grid:
    """Write a cube on an even grid in the object plane; see `rectified`. Memory is a few shards a thread.

    Args:
        cube: Path or URL of the cube.
        output: Folder of the new cube, which must not exist.
        geometry: Of the same instrument and object plane.
        pitch_mm: As of `rectified`.
        client: As of `scanhsi.processing.process`.
        threads: So many, without a cluster.
        codec: Of the new cube.
        resume: Go on with what an interrupted run left at ``output``.
        progress: Told after every shard.
        storage_options: As of `scanhsi.open_cube`.

    Returns:
        The grid.

    Raises:
        CalibrationError: As `rectified`; nothing was written.
        NotACube, CubeExists, CubeError: A cube cannot be read or written.
    """
    source = rectified(open_source(cube, storage_options), geometry, pitch_mm=pitch_mm)
    grid = Grid(np.asarray(source["x"].values), np.asarray(source["y"].values))
    pixels = source["cube"]
    spec = CubeSpec(
        lines=source.sizes["line"],
        bands=source.sizes["band"],
        samples=source.sizes["sample"],
        dtype=np.float32,
        significant_bits=None,
        attributes=attributes_of(source),
        wavelength_nm=source["wavelength"].values if "wavelength" in source.coords else None,
        pixel_attributes={str(key): str(value) for key, value in pixels.attrs.items()},
        coordinates=(
            Coordinate("x", ("sample",), grid.x_mm, X_ATTRIBUTES),
            Coordinate("y", ("line",), grid.y_mm, Y_ATTRIBUTES),
        ),
    )
    rewriting = Rewriting(source, Path(output), spec, choose_layout(spec), codec)
    rewriting.run(client=client, threads=threads, resume=resume, progress=progress)
    return grid

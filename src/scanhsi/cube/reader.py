"""Reads cubes: finished, interrupted, or still being written; from a folder or an object store.

xarray, and pandas with it, is imported where a dataset is made: a scan needs neither, and begins the sooner.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.core.metadata import ArrayV3Metadata

from scanhsi.cube.layout import FORMAT, STATUS
from scanhsi.cube.location import Location, locate, remote_errors
from scanhsi.cube.records import STAGES, Incident, LineRecords, LineStatus
from scanhsi.devices.errors import CubeError, NotACube

if TYPE_CHECKING:
    import xarray as xr

    from scanhsi.cube.stored import StoredArray

Chunks = Literal["auto"] | Mapping[str, int] | None
"""How dask cuts the cube: in whole shards, as told, or not at all."""

_TASK_BYTES: Final = 64_000_000
"""Of the pieces dask works on. Two threads hold a few of them; each costs some ms of scheduling."""


def open_cube(
    path: str | Path, *, chunks: Chunks = "auto", storage_options: Mapping[str, str] | None = None
) -> xr.Dataset:
    """Open a cube lazily: pixels are read as they are asked for, nothing is kept.

    The dataset holds the lines that were reached: a scan that was interrupted, or is still running, is a shorter cube. It stays as
    it was when it was opened; open it again to see the lines that came since.
    Lines in between that were lost are there, black, with ``status`` 2: ``ds.isel(line=ds.status == 1)`` leaves them out.

    Args:
        path: Folder of the cube, or URL of an object store (``s3://bucket/cube.zarr``; needs obstore).
        chunks: ``"auto"``: a dask array of whole shards, 64 MB or so each: for computing over the cube, also on a cluster,
            where two workers never read, or write, one shard. ``None``: no dask: the quickest for looking at a band, a
            spectrum, a colour picture. A mapping of dimension to length: as dask's own.
        storage_options: How to reach the object store, by obstore's names (``endpoint``, ``region``); the environment says the rest
            (``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY``, ``AWS_ENDPOINT_URL``, ``AWS_ALLOW_HTTP``). What is given here
            goes to the workers of a cluster with the work; the environment does not.

    Returns:
        Variable ``cube`` (band, line, sample) as it was stored, uint8 or uint16 straight from the camera. Coordinates: ``line`` as
        counted by the scan, ``band``, ``wavelength`` in nm where calibrated (``ds.cube.sel(wavelength=803, method="nearest")``),
        ``x`` and ``y`` in mm and ``wavelength_map`` (band, sample) where the cube has them,
        and per line ``status``, ``time``, mirror positions and stage stamps.
        Attributes: those of the cube, and ``lines_planned``, ``lines_stored``, ``lines_missing``.

    Raises:
        NotACube: The path is missing or holds something else.
        CubeError: The cube was written by a newer scanhsi, its files are damaged, or the object store cannot be read. Reading
            pixels later raises it, too.
    """
    opened = _open(path, storage_options)
    dataset = _dataset(opened)
    if chunks is not None:
        wanted = shard_chunks(opened.arrays["cube"]) if chunks == "auto" else dict(chunks)
        name = _dask_name(str(opened.location), opened.lines, _acquisition(opened))
        dataset["cube"] = dataset["cube"].variable.chunk(wanted, name=name)
    return dataset.assign_attrs(
        lines_planned=_planned(opened),
        lines_stored=int(np.count_nonzero(opened.status == LineStatus.STORED)),
        lines_missing=int(np.count_nonzero(opened.status == LineStatus.MISSING)),
    )


def read_records(path: str | Path, storage_options: Mapping[str, str] | None = None) -> LineRecords:
    """The records of the lines that were reached, as the engine kept them.

    Raises:
        NotACube, CubeError: As `open_cube`.
    """
    opened = _open(path, storage_options)
    records = LineRecords(opened.lines)
    records.status[:] = opened.status
    for name in ("mirror_step", "mirror_angle_rad", "frame_id", "device_ns"):
        getattr(records, name)[:] = opened.read_lines(name)
    for stage in STAGES:
        if stage != "started" or "started_ns" in opened.arrays:  # cubes written before scanhsi knew it
            records.stamps[stage][:] = opened.read_lines(f"{stage}_ns")
    for name in ("smeared", "attempt", "run"):
        if name in opened.arrays:
            getattr(records, name)[:] = opened.read_lines(name)
    records.incidents += [Incident.from_json(told) for told in opened.attributes.get("incidents", ())]
    records.missing.update(_missing(opened))
    return records


@dataclass(frozen=True, slots=True)
class CubeSummary:
    """What ``scanhsi info`` tells without reading a pixel.

    Attributes:
        path: Of the cube.
        shape: (bands, lines, samples), lines reached.
        dtype: ``uint8``, ``uint16`` or ``float32``.
        significant_bits: Of a pixel; None for float32.
        lines_planned: Lines of the plan.
        lines_stored: Lines whose pixels are safe.
        lines_missing: Lines that were lost.
        missing_reasons: line -> reason.
        complete: Every planned line ended stored or missing, and the cube was closed.
        simulated: Whether any device was simulated; None where the cube does not say.
        wavelength_nm: First and last wavelength, or None without a calibration.
        size_bytes: On disk.
        attributes: Everything else the cube says of itself: plan, instrument, devices, versions, acquisition.
    """

    path: str
    shape: tuple[int, int, int]
    dtype: str
    significant_bits: int | None
    lines_planned: int
    lines_stored: int
    lines_missing: int
    missing_reasons: dict[int, str]
    complete: bool
    simulated: bool | None
    wavelength_nm: tuple[float, float] | None
    size_bytes: int
    attributes: dict[str, Any]


def cube_summary(path: str | Path, storage_options: Mapping[str, str] | None = None) -> CubeSummary:
    """Sum up a cube; see `CubeSummary`.

    Raises:
        NotACube, CubeError: As `open_cube`.
    """
    opened = _open(path, storage_options)
    cube = opened.array("cube")
    attributes = dict(opened.attributes)
    simulated = attributes.pop("simulated", None)
    attributes.pop("missing", None)
    wavelength = opened.read("wavelength") if "wavelength" in opened.arrays else None
    return CubeSummary(
        path=str(opened.location),
        shape=(cube.shape[0], opened.lines, cube.shape[2]),
        dtype=str(cube.dtype),
        significant_bits=int(str(cube.attrs["significant_bits"])) if cube.dtype.kind == "u" else None,
        lines_planned=_planned(opened),
        lines_stored=int(np.count_nonzero(opened.status == LineStatus.STORED)),
        lines_missing=int(np.count_nonzero(opened.status == LineStatus.MISSING)),
        missing_reasons=_missing(opened),
        complete=attributes.pop("complete", False) is True,
        simulated=simulated if isinstance(simulated, bool) else None,
        wavelength_nm=None if wavelength is None else (float(wavelength[0]), float(wavelength[-1])),
        size_bytes=opened.location.size_bytes(),
        attributes=attributes,
    )


@dataclass(slots=True)
class _Opened:
    """A cube at one moment: its metadata, and which lines were safe then."""

    location: Location
    attributes: dict[str, Any]
    arrays: dict[str, zarr.Array[Any]]
    status: NDArray[np.uint8]

    @property
    def lines(self) -> int:
        return len(self.status)

    def array(self, name: str) -> zarr.Array[Any]:
        if name not in self.arrays:
            raise CubeError(f"{self.location} lacks its array {name!r}: the cube is damaged.")
        return self.arrays[name]

    def stored(self, name: str) -> StoredArray:
        from scanhsi.cube.stored import StoredArray

        return StoredArray(self.location, name, cast("ArrayV3Metadata", self.array(name).metadata))

    def read(self, name: str) -> NDArray[Any]:
        stored = self.stored(name)
        return stored.read((slice(None),) * len(stored.shape))

    def read_lines(self, name: str) -> NDArray[Any]:
        return self.stored(name).read((slice(0, self.lines),))


def _open(path: str | Path, storage_options: Mapping[str, str] | None) -> _Opened:
    location = locate(path, storage_options)
    group = _open_group(location)
    with remote_errors(location):
        opened = _Opened(location, dict(group.attrs), dict(group.arrays()), np.zeros(0, np.uint8))
    # Status before anything else: what it vouches for is on disk by now. Later reads can only find more.
    opened.status = _reached(opened.read(STATUS.name), finished=_acquisition(opened).get("finished") is not None)
    if _missing(opened).keys() - _reasons(opened).keys():  # written between the two: a reason comes before its status
        opened.attributes = dict(_open_group(location).attrs)
    return opened


def _open_group(location: Location) -> zarr.Group:
    path = location.path
    if path is not None and not path.exists():
        raise NotACube(f"there is no {path}.")
    if path is not None and not path.is_dir():
        raise NotACube(f"{path} is a file; a cube is a folder, conventionally *.zarr.")
    try:
        with remote_errors(location):
            group = zarr.open_group(location.store(), mode="r")
    except (FileNotFoundError, ValueError, KeyError, TypeError) as error:
        if path is None:
            raise NotACube(f"there is no Zarr group at {location}.") from None
        raise NotACube(f"{path} is a folder, but no Zarr group.") from error
    version = group.attrs.get("scanhsi_format")
    if not isinstance(version, int):
        raise NotACube(f"{location} is a Zarr group, but scanhsi did not write it.")
    if version > FORMAT:
        raise CubeError(
            f"{location} has cube format {version}; this scanhsi reads up to {FORMAT}.", hint="a newer scanhsi"
        )
    return group


def _reached(status: NDArray[np.uint8], *, finished: bool) -> NDArray[np.uint8]:
    """Status of the lines reached.

    Of a cube not yet closed that is up to the first line that is not safe: what lies behind it may be written anew. Of a
    closed one, a line without status is damage, and its neighbours are still worth seeing.
    """
    safe = np.flatnonzero(status)
    if not safe.size:
        return status[:0]
    holes = np.flatnonzero(status == LineStatus.NOT_STORED)
    return status[: safe[-1] + 1] if finished or not holes.size else status[: holes[0]]


def _dataset(opened: _Opened) -> xr.Dataset:
    """Every array with named dimensions, cut to the lines reached, decoded by its attributes."""
    import xarray as xr

    variables = {name: _variable(opened, name, array) for name, array in opened.arrays.items() if _dimensions(array)}
    dataset = xr.decode_cf(xr.Dataset(variables, attrs=opened.attributes))
    dataset = dataset.set_coords([name for name in ("x", "y", "wavelength_map") if name in dataset])
    dataset = dataset.assign_coords(line=np.arange(opened.lines), band=np.arange(dataset.sizes["band"]))
    for name in ("wavelength", "x", "y"):
        if name in dataset.coords and dataset[name].ndim == 1 and np.unique(dataset[name]).size == dataset[name].size:
            dataset = dataset.set_xindex(name)
    return dataset


def _dimensions(array: zarr.Array[Any]) -> tuple[str, ...]:
    names = cast("ArrayV3Metadata", array.metadata).dimension_names or ()
    return tuple(name for name in names if name)


def _variable(opened: _Opened, name: str, array: zarr.Array[Any]) -> xr.Variable:
    import xarray as xr
    from xarray.core import indexing

    dimensions = _dimensions(array)
    data: Any = opened.status if name == STATUS.name else indexing.LazilyIndexedArray(opened.stored(name))
    encoding = {"chunks": array.chunks, "shards": array.shards}
    variable = xr.Variable(dimensions, data, dict(array.attrs), encoding)
    if "quicklook_line" in dimensions:
        rows = -(-opened.lines // int(str(array.attrs.get("lines_per_pixel", 1))))
        return variable.isel(quicklook_line=slice(0, rows))
    return variable.isel(line=slice(0, opened.lines)) if "line" in dimensions else variable


def shard_chunks(cube: zarr.Array[Any]) -> dict[str, int]:
    """Chunks for dask: whole shards, several where they are small; where they are big, some bands, in whole inner chunks."""
    bands, lines, samples = cube.shards or cube.chunks
    size = bands * lines * samples * cube.dtype.itemsize
    inner = cube.chunks[0]
    share = -(-bands // inner // max(1, size // _TASK_BYTES)) * inner
    return {"band": min(share, cube.shape[0]), "line": lines * max(1, _TASK_BYTES // size), "sample": cube.shape[2]}


def _dask_name(*what: object) -> str:
    """Name of the dask array: the same for the same lines of the same cube, in every process."""
    from dask.base import tokenize

    return f"cube-{tokenize(*what)}"


def _acquisition(opened: _Opened) -> dict[str, Any]:
    acquisition = opened.attributes.get("acquisition")
    return cast("dict[str, Any]", acquisition) if isinstance(acquisition, dict) else {}


def _planned(opened: _Opened) -> int:
    planned = _acquisition(opened).get("lines_planned")
    return planned if isinstance(planned, int) else opened.array("cube").shape[1]


def _reasons(opened: _Opened) -> dict[int, str]:
    reasons = opened.attributes.get("missing")
    named = cast("dict[str, object]", reasons) if isinstance(reasons, dict) else {}
    return {int(line): str(reason) for line, reason in named.items()}


def _missing(opened: _Opened) -> dict[int, str]:
    """Reasons of the missing lines. A reason is written before the status: one of a line not reached does not count."""
    known = _reasons(opened)
    lines = (int(line) for line in np.flatnonzero(opened.status == LineStatus.MISSING))
    return {line: known.get(line, "reason not recorded") for line in lines}

"""Reads cubes: finished, interrupted, or still being written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
from numpy.typing import NDArray

from scanhsi.cube.layout import FORMAT, STATUS
from scanhsi.cube.records import STAGES, LineRecords, LineStatus
from scanhsi.devices.errors import CubeError, NotACube


def open_cube(path: str | Path) -> xr.Dataset:
    """Open a cube lazily: pixels are read as they are asked for, nothing is kept.

    The dataset holds the lines that were reached: a scan that was interrupted, or is still running, is a shorter cube.
    Lines in between that were lost are there, black, with ``status`` 2: ``ds.isel(line=ds.status == 1)`` leaves them out.

    Returns:
        Variable ``cube`` (band, line, sample), uint8 or uint16 as it came from the camera. Coordinates: ``line`` as counted by the
        scan, ``band``, ``wavelength`` in nm where calibrated (``ds.cube.sel(wavelength=803, method="nearest")``), and per line
        ``status``, ``time``, mirror positions and stage stamps. Attributes: those of the cube, and ``lines_planned``,
        ``lines_stored``, ``lines_missing``.

    Raises:
        NotACube: The path is missing or holds something else.
        CubeError: The cube was written by a newer scanhsi, or its files are damaged.
    """
    path = Path(path)
    group = _open_group(path)
    status = _status(group)
    dataset = xr.open_zarr(path, chunks=None)
    dataset = dataset.isel(line=slice(0, len(status)))
    dataset = dataset.assign_coords(line=np.arange(len(status)), band=np.arange(dataset.sizes["band"]))
    if "wavelength" in dataset.coords and np.unique(dataset["wavelength"]).size == dataset.sizes["band"]:
        dataset = dataset.set_xindex("wavelength")
    return dataset.assign_attrs(
        lines_planned=_planned(group),
        lines_stored=int(np.count_nonzero(status == LineStatus.STORED)),
        lines_missing=int(np.count_nonzero(status == LineStatus.MISSING)),
    )


def read_records(path: str | Path) -> LineRecords:
    """The records of the lines that were reached, as the engine kept them.

    Raises:
        NotACube, CubeError: As `open_cube`.
    """
    group = _open_group(Path(path))
    status = _status(group)
    records = LineRecords(len(status))
    records.status[:] = status
    for name in ("mirror_step", "mirror_angle_rad", "frame_id", "device_ns"):
        getattr(records, name)[:] = _array(group, name)[: len(status)]
    for stage in STAGES:
        if stage != "started" or "started_ns" in group:  # cubes written before scanhsi knew it
            records.stamps[stage][:] = _array(group, f"{stage}_ns")[: len(status)]
    if "smeared" in group:
        records.smeared[:] = _array(group, "smeared")[: len(status)]
    records.missing.update(_missing(group, status))
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


def cube_summary(path: str | Path) -> CubeSummary:
    """Sum up a cube; see `CubeSummary`.

    Raises:
        NotACube, CubeError: As `open_cube`.
    """
    path = Path(path)
    group = _open_group(path)
    status = _status(group)
    cube = _array(group, "cube")
    attributes = dict(group.attrs)
    wavelength = np.asarray(_array(group, "wavelength")[:]) if "wavelength" in group else None
    simulated = attributes.pop("simulated", None)
    attributes.pop("missing", None)
    return CubeSummary(
        path=str(path),
        shape=(cube.shape[0], len(status), cube.shape[2]),
        dtype=str(cube.dtype),
        significant_bits=int(str(cube.attrs["significant_bits"])) if cube.dtype.kind == "u" else None,
        lines_planned=_planned(group),
        lines_stored=int(np.count_nonzero(status == LineStatus.STORED)),
        lines_missing=int(np.count_nonzero(status == LineStatus.MISSING)),
        missing_reasons=_missing(group, status),
        complete=attributes.pop("complete", False) is True,
        simulated=simulated if isinstance(simulated, bool) else None,
        wavelength_nm=None if wavelength is None else (float(wavelength[0]), float(wavelength[-1])),
        size_bytes=sum(file.stat().st_size for file in path.rglob("*") if file.is_file()),
        attributes=attributes,
    )


def _open_group(path: Path) -> zarr.Group:
    if not path.exists():
        raise NotACube(f"there is no {path}.")
    if not path.is_dir():
        raise NotACube(f"{path} is a file; a cube is a folder, conventionally *.zarr.")
    try:
        group = zarr.open_group(path, mode="r")
    except (FileNotFoundError, ValueError, KeyError, TypeError) as error:
        raise NotACube(f"{path} is a folder, but no Zarr group.") from error
    version = group.attrs.get("scanhsi_format")
    if not isinstance(version, int):
        raise NotACube(f"{path} is a Zarr group, but scanhsi did not write it.")
    if version > FORMAT:
        raise CubeError(f"{path} has cube format {version}; this scanhsi reads up to {FORMAT}.", hint="a newer scanhsi")
    return group


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    array = group.get(name)
    if not isinstance(array, zarr.Array):
        raise CubeError(f"{group.store} lacks its array {name!r}: the cube is damaged.")
    return array


def _status(group: zarr.Group) -> NDArray[np.uint8]:
    """Status of the lines reached: without the zeros at the end, where nothing was ever stored."""
    status = np.asarray(_array(group, STATUS.name)[:], np.uint8)
    reached = np.flatnonzero(status)
    return status[: reached[-1] + 1] if reached.size else status[:0]


def _planned(group: zarr.Group) -> int:
    acquisition = group.attrs.get("acquisition")
    planned = acquisition.get("lines_planned") if isinstance(acquisition, dict) else None
    return planned if isinstance(planned, int) else _array(group, "cube").shape[1]


def _missing(group: zarr.Group, status: NDArray[np.uint8]) -> dict[int, str]:
    """Reasons of the missing lines. A reason is written before the status: one of a line not reached does not count."""
    reasons = group.attrs.get("missing")
    known = {int(line): str(reason) for line, reason in reasons.items()} if isinstance(reasons, dict) else {}
    lines = (int(line) for line in np.flatnonzero(status == LineStatus.MISSING))
    return {line: known.get(line, "reason not recorded") for line in lines}

"""Opens NetCDF files for import: those of OpenHSI, and our own exports."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.cube.exchange.incoming import Incoming
from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CubeError

_AXES: Final = {"datacube": ("wavelength", "y", "x"), "cube": ("band", "line", "sample")}
"""Name of the variable -> its dimensions as (band, line, sample): OpenHSI calls the scan direction y; ours."""

_MAGIC: Final = (b"CDF", b"\x89HDF")

_LARGEST_KEPT: Final = 4096
"""Values of a calibration array that are kept in the attributes of the cube."""


def open_netcdf(path: Path, calibration: Path | None) -> Incoming:
    """Open a NetCDF file of OpenHSI, or one exported by scanhsi.

    Args:
        path: The file.
        calibration: OpenHSI's calibration file (``.nc``): wavelengths of a cube that was saved without, and what else there is
            that is small (smile shifts, spectral fits).

    Raises:
        CubeError: It cannot be read, or holds neither.
    """
    dataset = _open(path)
    name = next((name for name in _AXES if name in dataset.data_vars), None)
    if name is None or set(dataset[name].dims) != set(_AXES[name]):
        held = ", ".join(f"{name} {value.dims}" for name, value in dataset.data_vars.items()) or "nothing"
        raise CubeError(
            f"{path} holds {held}; OpenHSI has datacube (wavelength, x, y), scanhsi cube (band, line, sample)."
        )
    band, line, sample = _AXES[name]
    pixels = dataset[name].transpose(line, band, sample)

    def read(first: int, stop: int) -> NDArray[Any]:
        try:
            return pixels.isel({line: slice(first, stop)}).to_numpy()
        except (OSError, RuntimeError, ValueError) as error:
            raise CubeError(f"lines {first} to {stop - 1} of {path} cannot be read: {error}") from error

    lines, bands, samples = pixels.shape
    dtype = np.dtype(pixels.dtype).newbyteorder("=")
    incoming = Incoming(
        path, "OpenHSI NetCDF", (bands, lines, samples), dtype, read, dataset.close, _plain(dict(dataset.attrs))
    )
    incoming.units, incoming.quantity = pixels.attrs.get("units"), pixels.attrs.get("long_name")
    if name == "cube":
        _ours(incoming, dataset)
    else:
        _openhsi(incoming, dataset, calibration)
    return incoming


def is_netcdf(path: Path) -> bool:
    """Whether a file is NetCDF, by its first bytes or its ending."""
    with path.open("rb") as file:
        start = file.read(4)
    return start.startswith(_MAGIC) or path.suffix.lower() in (".nc", ".nc4", ".cdf")


def _open(path: Path) -> xr.Dataset:
    """Open lazily; the classic formats (NetCDF-3) are read by scipy, NetCDF-4 by h5netcdf."""
    try:
        with path.open("rb") as file:
            classic = file.read(3) == b"CDF"
        return xr.open_dataset(
            path, engine="scipy" if classic else "h5netcdf", chunks=None, cache=False, mask_and_scale=False
        )
    except (OSError, ValueError) as error:
        raise CubeError(f"{path} cannot be read as NetCDF: {error}") from error


def _ours(incoming: Incoming, dataset: xr.Dataset) -> None:
    incoming.format = "scanhsi NetCDF"
    incoming.significant_bits = _maybe_int(dataset["cube"].attrs.get("significant_bits"))
    simulated = dataset.attrs.get("simulated")
    incoming.simulated = None if simulated is None else simulated == "true"
    incoming.wavelength_nm, incoming.fwhm_nm = _per_band(dataset, "wavelength"), _per_band(dataset, "fwhm")
    reasons: dict[str, str] = json.loads(dataset.attrs.get("missing", "{}"))
    numbers = np.asarray(dataset["line"].values)
    for line in np.flatnonzero(dataset["status"].values != LineStatus.STORED):
        incoming.missing[int(line)] = reasons.get(str(numbers[line]), f"missing in {incoming.path.name}")
    incoming.columns = {
        str(name): _integers(value) for name, value in dataset.variables.items() if value.dims == ("line",)
    }


def _per_band(dataset: xr.Dataset, name: str) -> NDArray[np.float64] | None:
    return np.asarray(dataset[name].values, np.float64) if name in dataset.variables else None


def _openhsi(incoming: Incoming, dataset: xr.Dataset, calibration: Path | None) -> None:
    bands, lines, _ = incoming.shape
    wavelength = _per_band(dataset, "wavelength")
    if wavelength is not None and not np.array_equal(wavelength, np.arange(bands)):
        incoming.wavelength_nm = wavelength
    if "time" in dataset.variables and dataset["time"].shape == (lines,):
        incoming.columns["time"] = _integers(dataset["time"].variable)
    if "temperature" in dataset.variables:
        values = np.asarray(dataset["temperature"].values, np.float64)
        incoming.header = {
            **incoming.header,
            "temperature_degC": [float(value) for value in values if np.isfinite(value)],
        }
    if calibration is not None:
        _apply_calibration(incoming, calibration)
    if incoming.wavelength_nm is None:
        incoming.notes.append("the file has no wavelengths: give OpenHSI's calibration file (.nc) to have them")


def _apply_calibration(incoming: Incoming, path: Path) -> None:
    refuse_pickle(path)
    with _open(path) as dataset:
        _take_calibration(incoming, dataset, path)


def _take_calibration(incoming: Incoming, dataset: xr.Dataset, path: Path) -> None:
    bands = incoming.shape[0]
    for name in ("wavelengths", "wavelengths_linear"):
        if incoming.wavelength_nm is None and name in dataset.variables and dataset[name].shape == (bands,):
            incoming.wavelength_nm = np.asarray(dataset[name].values, np.float64)
            incoming.notes.append(f"wavelengths are {name!r} of {path.name}")
    if incoming.wavelength_nm is None:
        found = {name: dataset[name].shape for name in ("wavelengths", "wavelengths_linear") if name in dataset}
        raise CubeError(f"{path} has no wavelengths for {bands} bands; it has {found or 'none'}.")
    small = {str(name): value for name, value in dataset.variables.items() if value.size <= _LARGEST_KEPT}
    left = [f"{name} {value.shape}" for name, value in dataset.variables.items() if str(name) not in small]
    kept = {name: _plain(np.asarray(value.values).tolist()) for name, value in small.items()}
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    told = {"file": path.name, "sha256": digest, "attributes": _plain(dict(dataset.attrs)), **kept}
    incoming.header = {**incoming.header, "calibration": told}
    if left:
        incoming.notes.append(f"not carried over from {path.name}: {', '.join(left)}; keep that file")


def refuse_pickle(path: Path) -> None:
    """Raise `CubeError` for a pickle, by its ending or its first bytes. It is not loaded, not even in part."""
    try:
        with path.open("rb") as file:
            start = file.read(2)
    except OSError as error:
        raise CubeError(f"cannot read {path}: {error.strerror or error}.") from error
    if path.suffix.lower() in (".pkl", ".pickle") or (start[:1] == b"\x80" and start[1:] in b"\x02\x03\x04\x05"):
        raise CubeError(
            f"{path} is a pickle, and no pickle is ever loaded here: loading one runs whatever code is in it.",
            hint="where you trust it, let OpenHSI write it anew: CameraProperties(json_path=..., cal_path='cal.pkl') "
            "saves cal.nc beside it",
        )


def _integers(variable: xr.Variable) -> NDArray[Any]:
    """A column as numbers: times as int64 ns, the smallest where there is none."""
    values = np.asarray(variable.values)
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64)  # NaT is NOT_STAMPED
    return values


def _maybe_int(value: object) -> int | None:
    return None if value is None else int(cast("int", value))


def _plain(value: Any) -> Any:
    """Attributes as JSON has them; numbers that JSON lacks become None."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in cast("dict[Any, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in cast("list[Any]", value)]
    if isinstance(value, np.generic | np.ndarray):
        return _plain(cast("Any", value).tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if value is None or isinstance(value, str | int | float | bool) else str(value)

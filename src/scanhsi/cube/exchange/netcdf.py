"""NetCDF-4 (CF 1.11): everything that a cube knows, and a quality flag for each pixel."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, cast

import h5netcdf
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.cube.exchange.output import new_files
from scanhsi.cube.exchange.source import Source
from scanhsi.cube.records import NOT_STAMPED

_DIMENSIONS: Final = ("band", "line", "sample")
_COMPRESSED: Final[dict[str, Any]] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_QUALITY: Final = {
    "long_name": "what is to be known of a pixel",
    "flag_values": np.array([0, 1, 2], np.uint8),
    "flag_meanings": "good saturated missing",
}
_TIME: Final = {"units": "nanoseconds since 1970-01-01T00:00:00Z", "calendar": "proleptic_gregorian"}


def write_netcdf(source: Source, output: Path) -> list[Path]:
    """Write a NetCDF-4 file, chunked and compressed (zlib 1, shuffled); returns its path.

    Pixels are what they were; those of missing lines are 0. ``quality`` (band, line, sample) flags saturated and missing ones.

    Raises:
        CubeExists, CubeError: As `new_files`.
    """
    with new_files(output) as (new,), h5netcdf.File(new, "w") as file:
        file.dimensions = dict(zip(_DIMENSIONS, source.shape, strict=True))
        file.attrs.update({"Conventions": "CF-1.11", "title": source.summary, **_plain(source.dataset.attrs)})
        names = [_write_coordinate(file, source, str(name)) for name in _carried(source.dataset)]
        _write_pixels(file, source, [name for name in names if name not in _DIMENSIONS])
    return [output]


def _write_pixels(file: h5netcdf.File, source: Source, coordinates: list[str]) -> None:
    cube = _pixel_variable(file, source, "cube", source.dtype)
    cube.attrs.update(_plain({**source.pixels.attrs, "coordinates": " ".join(coordinates)}))
    cube.attrs["ancillary_variables"] = "quality status"
    quality = _pixel_variable(file, source, "quality", np.dtype(np.uint8))
    quality.attrs.update(_QUALITY)
    top = np.inf if source.saturation is None else source.saturation
    for first, pixels in source.blocks():
        lines = slice(first, first + pixels.shape[1])
        cube[:, lines, :] = pixels
        flags = (pixels >= top).astype(np.uint8)
        flags[:, source.missing[lines]] = 2
        quality[:, lines, :] = flags


def _pixel_variable(file: h5netcdf.File, source: Source, name: str, dtype: np.dtype[Any]) -> h5netcdf.Variable:
    made: Any = file.create_variable(name, _DIMENSIONS, dtype, chunks=source.chunk, **_COMPRESSED)  # pyright: ignore[reportUnknownVariableType] has no types
    return cast("h5netcdf.Variable", made)


def _carried(dataset: xr.Dataset) -> list[str]:
    """Everything that goes along one axis of the cube: wavelengths, positions, records of the lines."""
    return [str(name) for name, value in dataset.variables.items() if value.dims in (("band",), ("line",), ("sample",))]


def _write_coordinate(file: h5netcdf.File, source: Source, name: str) -> str:
    values, attributes = numbers_of(source.dataset[name])
    variable = cast(
        "h5netcdf.Variable", file.create_variable(name, source.dataset[name].dims, values.dtype, data=values)
    )
    variable.attrs.update(_plain(attributes))
    return name


def numbers_of(array: xr.DataArray) -> tuple[NDArray[Any], dict[str, Any]]:
    """A coordinate as plain numbers, with its attributes: times as int64 ns, the smallest where there is none."""
    values, attributes = np.asarray(array.values), {str(key): value for key, value in array.attrs.items()}
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]").astype(np.int64)
        attributes |= {**_TIME, "_FillValue": np.int64(NOT_STAMPED)}
    return values, attributes


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as NetCDF can have them: numbers and text; lists and tables as JSON."""
    return {str(name): _plain_value(value) for name, value in attributes.items() if value is not None}


def _plain_value(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | dict):
        return json.dumps(value)
    return value

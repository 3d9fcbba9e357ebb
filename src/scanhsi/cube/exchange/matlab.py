"""MAT-files: version 5 up to 2 GB a variable, 7.3 (HDF5) beyond. ``cube(line, sample, band)``, as MATLAB has images."""

from __future__ import annotations

import json
import struct
import time
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import h5py
import numpy as np
import scipy.io
from numpy.typing import NDArray

from scanhsi.cube.exchange.netcdf import numbers_of
from scanhsi.cube.exchange.output import new_files
from scanhsi.cube.exchange.source import Source
from scanhsi.devices.errors import ConfigError

MatVersion = Literal["5", "7.3"]

_LIMIT_BYTES: Final = 2**31
_LARGEST: Final = _LIMIT_BYTES - 1024
_TYPES: Final = {"uint8": (2, 9), "uint16": (4, 11), "uint32": (6, 13), "float32": (7, 7)}  # stored as, class
_CLASSES: Final = {"float64": "double", "float32": "single"}


def write_matlab(source: Source, output: Path, *, version: MatVersion | None = None) -> list[Path]:
    """Write a MAT-file; returns its path.

    Pixels are what they were; those of missing lines are 0, and ``missing`` lists those lines, counted from 1.

    Args:
        source: What to write.
        output: The file.
        version: ``5`` or ``7.3``; None: 5 where the cube is below 2 GB.

    Raises:
        ConfigError: Version 5, and the cube is larger than it can hold.
        CubeExists, CubeError: As `new_files`.
    """
    if version is None:
        version = "5" if source.nbytes < _LARGEST else "7.3"
    if version == "5" and source.nbytes >= _LARGEST:
        size = f"{source.nbytes / 1e9:.1f} GB"
        raise ConfigError(f"a variable of a MAT-file version 5 ends at 2 GB; these are {size}.", hint="version 7.3")
    with new_files(output) as (new,):
        if version == "5":
            _write_5(source, new)
        else:
            _write_73(source, new)
    return [output]


def _variables(source: Source) -> dict[str, NDArray[Any] | str]:
    """Everything but the pixels: columns, scalars, and the attributes as JSON."""
    found: dict[str, NDArray[Any] | str] = {}
    for name, value in source.dataset.variables.items():
        if value.ndim == 1 and value.dims[0] in ("band", "line", "sample"):
            found[str(name)] = numbers_of(source.dataset[name])[0].reshape(-1, 1)
    if source.saturation is not None:
        found["saturation"] = np.array([[float(source.saturation)]])
    found["missing"] = np.flatnonzero(source.missing).astype(np.float64).reshape(-1, 1) + 1
    found["title"] = source.summary
    found["attributes"] = json.dumps(dict(source.dataset.attrs), default=str)
    return found


def _write_5(source: Source, path: Path) -> None:
    with path.open("wb") as file:
        scipy.io.savemat(file, _variables(source))
        _matrix_head(source, file)
        for pixels in source.columns():
            file.write(np.ascontiguousarray(pixels.transpose(0, 2, 1)).data.cast("B"))
        file.write(bytes(-source.nbytes % 8))


def _matrix_head(source: Source, file: BinaryIO) -> None:
    """Begin the variable ``cube``: scipy would want it in memory whole. Layout: "MAT-File Format", MathWorks, chapter 1."""
    stored_as, array_class = _TYPES[source.dtype.name]
    bands, lines, samples = source.shape
    head = struct.pack("=IIII", 6, 8, array_class, 0)  # array flags
    head += struct.pack("=IIiii4x", 5, 12, lines, samples, bands)  # dimensions
    head += struct.pack("=II8s", 1, 4, b"cube")  # name
    head += struct.pack("=II", stored_as, source.nbytes)
    file.write(struct.pack("=II", 14, len(head) + source.nbytes + -source.nbytes % 8) + head)


def _write_73(source: Source, path: Path) -> None:
    bands, lines, samples = source.shape
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in _variables(source).items():
            _write_h5(file, name, value)
        chunk = (source.chunk[0], source.chunk[2], source.chunk[1])
        cube = file.create_dataset(
            "cube",
            (bands, samples, lines),
            source.dtype,
            chunks=chunk,
            compression="gzip",
            compression_opts=1,
            shuffle=True,
        )
        cube.attrs["MATLAB_class"] = np.bytes_(_CLASSES.get(source.dtype.name, source.dtype.name))
        for first, pixels in source.blocks():
            cube[:, :, first : first + pixels.shape[1]] = pixels.transpose(0, 2, 1)
    text = f"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: {time.asctime()} HDF5 schema 1.00 ."
    with path.open("r+b") as file:  # what makes MATLAB take it for its own
        file.write(text.encode().ljust(116) + bytes(8) + b"\x00\x02IM")


def _write_h5(file: h5py.File, name: str, value: NDArray[Any] | str) -> None:
    if isinstance(value, str):
        units = np.frombuffer(value.encode("utf-16-le"), np.uint16).reshape(-1, 1)
        written = file.create_dataset(name, data=units)
        written.attrs["MATLAB_class"] = np.bytes_("char")
        written.attrs["MATLAB_int_decode"] = np.int32(2)
        return
    if value.size == 0:  # MATLAB stores the shape of what is empty
        written = file.create_dataset(name, data=np.array(value.shape, np.uint64))
        written.attrs["MATLAB_empty"] = np.uint8(1)
    else:
        written = file.create_dataset(name, data=value.T)
    written.attrs["MATLAB_class"] = np.bytes_(_CLASSES.get(value.dtype.name, value.dtype.name))

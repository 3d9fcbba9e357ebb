"""Arrays of a cube for xarray: nothing is read before it is asked for, nothing is kept.

Local files are read through tensorstore where it is installed: it takes a quarter to a half of zarr-python's time, and it never
mixes two versions of a shard that is replaced under it. Without it, and for URLs, zarr-python reads.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
import zarr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing
from zarr.core.buffer import default_buffer_prototype
from zarr.core.metadata import ArrayV3Metadata
from zarr.storage import StorePath

from scanhsi.cube.location import Location, remote_errors
from scanhsi.devices.errors import CubeError, NotACube

Index = int | slice | NDArray[np.intp]
_Read = Callable[[tuple[Index, ...]], NDArray[Any]]

# Values are read once and not again: a cache would only take memory.
_NO_CACHE: Final = {"cache_pool": {"total_bytes_limit": 0}}


class StoredArray(BackendArray):
    """One array of a cube. Opened at the first read; threads may share it; goes to other processes as place and metadata.

    The metadata is that of the moment when the cube was opened: arrays that are cut to the lines reached meanwhile, one after
    another, do not matter.

    Args:
        location: Of the cube.
        name: Of the array.
        metadata: The array's ``zarr.json``.
    """

    def __init__(self, location: Location, name: str, metadata: ArrayV3Metadata) -> None:
        self.shape = metadata.shape
        self.dtype: np.dtype[Any] = np.dtype(metadata.dtype.to_native_dtype())
        self._location = location
        self._name = name
        self._metadata = metadata
        self._reader: _Read | None = None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return StoredArray, (self._location, self._name, self._metadata)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self.read)

    def read(self, key: tuple[Index, ...]) -> NDArray[Any]:
        """Values at an outer (orthogonal) index of integers, slices with positive steps and integer arrays.

        Raises:
            CubeError: They cannot be read.
        """
        plain = tuple(_plain(index, length) for index, length in zip(key, self.shape, strict=True))
        try:
            with remote_errors(self._location):
                return self._opened()(plain)
        except NotACube as error:
            raise CubeError(f"{self._name!r} of {self._location} is gone.") from error
        except (OSError, ValueError, RuntimeError, KeyError) as error:
            raise CubeError(
                f"{self._name!r} of {self._location} cannot be read: {_first_line(error)}.",
                hint=f"scanhsi verify {self._location}",
            ) from error

    def _opened(self) -> _Read:
        with self._lock:
            if self._reader is None:
                use_zarr = self._location.path is None or find_spec("tensorstore") is None
                open_reader = _zarr_reader if use_zarr else _tensorstore_reader
                self._reader = open_reader(self._location, self._name, self._metadata)
            return self._reader


def _tensorstore_reader(location: Location, name: str, metadata: ArrayV3Metadata) -> _Read:
    import tensorstore  # only here: it is optional, and takes half a second

    spec = {
        "driver": "zarr3",
        "kvstore": {"driver": "file", "path": f"{os.path.abspath(location.text)}/{name}/"},  # it takes no ".."
        "metadata": _as_json(metadata),
    }
    context = tensorstore.Context(_NO_CACHE)
    array = tensorstore.open(spec, read=True, open=True, assume_metadata=True, context=context).result()
    return lambda key: np.asarray(array.oindex[key].read().result())


def _zarr_reader(location: Location, name: str, metadata: ArrayV3Metadata) -> _Read:
    array = zarr.Array(zarr.AsyncArray(metadata, StorePath(location.store(), name)))
    return lambda key: np.asarray(array.oindex[key])


def _as_json(metadata: ArrayV3Metadata) -> dict[str, Any]:
    text = metadata.to_buffer_dict(default_buffer_prototype())["zarr.json"].to_bytes()
    fields = json.loads(text)
    return {key: value for key, value in fields.items() if key not in ("attributes", "storage_transformers")}


def _plain(index: Index, length: int) -> Index:
    """The index without negative numbers and open ends, which tensorstore understands otherwise."""
    if isinstance(index, slice):
        start, stop, step = index.indices(length)
        return slice(start, max(start, stop), step)
    if isinstance(index, np.ndarray):
        return np.where(index < 0, index + length, index)
    return int(index) + length if index < 0 else int(index)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")

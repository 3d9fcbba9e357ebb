"""What a cube holds, read without the code that wrote it: pixels through zarr-python, records as the bytes they are."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from scanhsi.cube import LineStatus
from scanhsi.cube.destination import Destination


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A cube at some moment.

    Attributes:
        attributes: Of the group.
        status: (lines,), as many as the cube says there are.
        pixels: (line, band, sample) of the lines that have a status.
    """

    attributes: Mapping[str, Any]
    status: NDArray[np.uint8]
    pixels: NDArray[Any]
    _columns: Mapping[str, NDArray[Any]]

    def column(self, name: str) -> NDArray[Any]:
        """A per-line array."""
        return self._columns[name]

    @property
    def reached(self) -> int:
        """Lines that have a status."""
        return int(np.count_nonzero(self.status))

    @property
    def stored(self) -> int:
        """Lines that are stored."""
        return int(np.count_nonzero(self.status == LineStatus.STORED))

    @property
    def missing(self) -> dict[int, str]:
        """Reasons of the lines that are missing."""
        return {int(line): reason for line, reason in self.attributes.get("missing", {}).items()}


_COLUMNS = ("exposure_start_ns", "trigger_ns", "stored_ns", "mirror_step", "frame_id", "smeared", "time", "run")


def snapshot(destination: Destination) -> Snapshot | None:
    """Read a cube; None where there is none.

    Raises:
        Exception: It cannot be read: whatever the reader says.
    """
    root = destination.get("zarr.json")
    if root is None:
        return None
    document = json.loads(root)
    arrays: dict[str, Any] = document["consolidated_metadata"]["metadata"]
    status = _column(destination, arrays, "status")
    columns = {name: _column(destination, arrays, name) for name in _COLUMNS}
    return Snapshot(document["attributes"], status, _pixels(destination, arrays["cube"], status), columns)


def _column(destination: Destination, arrays: Mapping[str, Any], name: str) -> NDArray[Any]:
    document = arrays[name]
    (length,), (chunk,) = document["shape"], document["chunk_grid"]["configuration"]["chunk_shape"]
    kind = np.dtype(document["data_type"])
    values = np.full(-(-length // chunk) * chunk, document["fill_value"], kind)
    for number in range(len(values) // chunk):
        if (contents := destination.get(f"{name}/c/{number}")) is not None:
            values[number * chunk : (number + 1) * chunk] = np.frombuffer(contents, kind)
    return values[:length]


def _pixels(destination: Destination, document: Mapping[str, Any], status: NDArray[np.uint8]) -> NDArray[Any]:
    reached = int(np.count_nonzero(status))
    chunk = document["chunk_grid"]["configuration"]["chunk_shape"][1]
    buffer = default_buffer_prototype().buffer.from_bytes
    files = {"zarr.json": buffer(json.dumps(document).encode())}
    for number in range(-(-reached // chunk)):
        if (contents := destination.get(f"cube/c/0/{number}/0")) is not None:
            files[f"c/0/{number}/0"] = buffer(contents)
    array = zarr.open_array(MemoryStore(files), mode="r")
    return np.asarray(array[:, :reached, :]).transpose(1, 0, 2)

"""Putting shards and records on disk through zarr-python: the part of the writer that runs in threads.

`CubeFiles` knows files and arrays, and nothing of slots, lines in flight or event loops; `scanhsi.cube.writer` knows nothing of
zarr. A faster way to write shards replaces `CubeFiles` and must keep its order: pixels, records, status, each on disk before the
next begins.
"""

from __future__ import annotations

import errno
import shutil
import uuid
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.abc.buffer import Buffer
from zarr.abc.store import Store
from zarr.codecs import BloscCodec
from zarr.errors import ZarrUserWarning
from zarr.storage import MemoryStore

from scanhsi.cube.conventions import root_attributes
from scanhsi.cube.durable import DurableStore, sync_directory, write_durably
from scanhsi.cube.layout import (
    DIMENSIONS,
    FORMAT,
    RECORDS,
    STATUS,
    WAVELENGTH_ATTRIBUTES,
    CubeSpec,
    Layout,
    LineVariable,
    cube_attributes,
)
from scanhsi.devices.errors import CubeError, CubeExists
from scanhsi.devices.frames import Pixels

Codec = Literal["lz4", "zstd", "none"]
"""How pixels are compressed: fast, smaller at 1.6 times the work, not at all."""

_BLOSC: Final[dict[str, tuple[Literal["lz4", "zstd"], int, int]]] = {"lz4": ("lz4", 5, 0), "zstd": ("zstd", 1, 262_144)}


@dataclass(frozen=True, slots=True)
class ShardRecords:
    """What is written of some lines of one shard after their pixels.

    Attributes:
        first: First line of the shard.
        columns: Name of each per-line array -> its values from ``first`` on.
        status: uint8, from ``first`` on.
        missing: Every line missing so far -> reason; None where that has not changed.
    """

    first: int
    columns: Mapping[str, NDArray[Any]]
    status: NDArray[np.uint8]
    missing: Mapping[int, str] | None = None


class CubeFiles:
    """The files of one cube being written. Every method blocks; one call at a time, from any thread."""

    def __init__(self, path: Path, spec: CubeSpec, layout: Layout, codec: Codec = "lz4") -> None:
        self.path = path
        self._spec = spec
        self._layout = layout
        self._codec: Codec = codec

    def create(self, attributes: Mapping[str, Any]) -> None:
        """Create the whole group at its planned size, all or nothing: it appears under its name when it is complete.

        Raises:
            CubeExists: Something is there already; it was not touched.
            CubeError: The folder is missing, not writable, or full.
        """
        if self.path.exists() or self.path.is_symlink():
            raise CubeExists(
                f"{self.path} exists already; nothing was written.", hint="another name, or move it away first"
            )
        if not self.path.parent.is_dir():
            raise CubeError(
                f"there is no folder {self.path.parent} to write into.", hint=f"mkdir -p {self.path.parent}"
            )
        building = self.path.with_name(f".{self.path.name}.{uuid.uuid4().hex}.partial")
        try:
            for key, value in self._metadata(attributes).items():
                write_durably(building / key, value.as_numpy_array().data)
            building.rename(self.path)
            sync_directory(self.path.parent)
        except OSError as error:
            if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):  # somebody was faster
                raise _exists(self.path) from error
            raise disk_error(self.path, error, needed=0) from error
        finally:
            shutil.rmtree(building, ignore_errors=True)
        self._open()

    def _metadata(self, attributes: Mapping[str, Any]) -> dict[str, Buffer]:
        """The files of the empty cube: key -> contents."""
        files: dict[str, Buffer] = {}
        store = MemoryStore(files)
        spec, layout = self._spec, self._layout
        head = {**root_attributes(), "scanhsi_format": FORMAT, **spec.attributes, **attributes}
        group = zarr.create_group(store, attributes={**head, "complete": False, "missing": {}})
        if spec.wavelength_nm is not None:
            group.create_array(
                "wavelength",
                data=np.asarray(spec.wavelength_nm, np.float64),
                chunks=(spec.bands,),
                compressors=None,
                dimension_names=("band",),
                attributes=dict(WAVELENGTH_ATTRIBUTES),
            )
        for variable in (*RECORDS, STATUS):
            self._create_line_array(group, variable)
        group.create_array(
            "cube",
            shape=spec.shape,
            dtype=np.dtype(spec.dtype),
            chunks=layout.chunk,
            shards=layout.shard,
            compressors=_compressor(self._codec, np.dtype(spec.dtype).itemsize),
            fill_value=0,
            dimension_names=DIMENSIONS,
            attributes=cube_attributes(spec),
        )
        _consolidate(store)
        return files

    def _create_line_array(self, group: zarr.Group, variable: LineVariable) -> None:
        group.create_array(
            variable.name,
            shape=(self._spec.lines,),
            dtype=variable.dtype,
            chunks=(self._layout.lines_per_shard,),
            compressors=None,
            fill_value=variable.fill,
            dimension_names=("line",),
            attributes=dict(variable.attributes),
        )

    def _open(self) -> None:
        self._group = zarr.open_group(DurableStore(self.path), mode="r+")
        # An all-zero chunk is data too: without this zarr would delete it, and "the file is there" would prove nothing.
        self._arrays = {name: array.with_config({"write_empty_chunks": True}) for name, array in self._group.arrays()}

    def write_pixels(self, first: int, rows: Pixels) -> None:
        """Write (or write anew, longer) one shard.

        Args:
            first: First line of the shard.
            rows: (lines, band, sample).

        Raises:
            CubeError: It is not on disk; what was there before still is.
        """
        try:
            self._arrays["cube"][:, first : first + len(rows), :] = rows.transpose(1, 0, 2)
        except OSError as error:
            raise disk_error(self.path, error, needed=rows.nbytes) from error

    def write_records(self, records: ShardRecords) -> None:
        """Write what is known of a shard's lines, then the status that says they are safe.

        Raises:
            CubeError: The status was not written.
        """
        try:
            if records.missing is not None:
                self._annotate({"missing": {str(line): reason for line, reason in sorted(records.missing.items())}})
            for variable in RECORDS:
                self._write_line_chunk(variable, records.first, records.columns[variable.name])
            self._write_line_chunk(STATUS, records.first, records.status)
        except OSError as error:
            raise disk_error(self.path, error, needed=100_000) from error

    def _write_line_chunk(self, variable: LineVariable, first: int, column: NDArray[Any]) -> None:
        """Write one chunk of a per-line array: uncompressed, so its file is its values.

        Through zarr the 15 arrays of a shard keep the interpreter busy for 20 ms, while the engine wants it; like this, for 7.
        """
        lines = self._layout.lines_per_shard
        chunk = np.full(lines, variable.fill, np.dtype(variable.dtype).newbyteorder("<"))
        chunk[: len(column)] = column
        write_durably(self.path / variable.name / "c" / str(first // lines), chunk.tobytes())

    def finish(self, reached: int, attributes: Mapping[str, Any]) -> None:
        """Cut the arrays to the lines reached and write the closing attributes.

        Readers take the consolidated metadata in the root, which is replaced last and whole: they see the old sizes or the new.

        Raises:
            CubeError: The cube stays as it was: planned sizes, status telling what is there.
        """
        try:
            for name in ("cube", STATUS.name, *(variable.name for variable in RECORDS)):
                _cut(self._arrays[name], reached)
            self._annotate(attributes)
            _consolidate(self._group.store)
        except OSError as error:
            raise disk_error(self.path, error, needed=100_000) from error

    def _annotate(self, attributes: Mapping[str, Any]) -> None:
        self._group = self._group.update_attributes(dict(attributes))


def _exists(path: Path) -> CubeExists:
    return CubeExists(f"{path} exists already; nothing was written.", hint="another name, or move it away first")


def _cut(array: zarr.Array[Any], lines: int) -> None:
    shape = (array.shape[0], lines, array.shape[2]) if array.ndim == 3 else (lines,)
    if shape != array.shape:
        array.resize(shape)


def _compressor(codec: Codec, itemsize: int) -> BloscCodec | None:
    if codec == "none":
        return None
    cname, level, blocksize = _BLOSC[codec]
    return BloscCodec(cname=cname, clevel=level, shuffle="bitshuffle", typesize=itemsize, blocksize=blocksize)


def _consolidate(store: Store) -> None:
    with warnings.catch_warnings():
        # It says that consolidated metadata is not in the v3 specification yet. Readers that do not know it ignore it.
        warnings.filterwarnings("ignore", "Consolidated metadata is currently not part", ZarrUserWarning)
        zarr.consolidate_metadata(store)


def disk_error(path: Path, error: OSError, *, needed: int) -> CubeError:
    """An error of the file system, as the user needs to read it.

    Args:
        path: The cube.
        error: What the system said.
        needed: Bytes that were to be written at once, at most; 0 where that is little.
    """
    if error.errno not in (errno.ENOSPC, errno.EDQUOT):
        return CubeError(f"cannot write {path}: {error.strerror or error}.")
    free = shutil.disk_usage(path if path.exists() else path.parent).free
    wanted = f"up to {needed / 1e6:.1f} MB were needed, " if needed else ""
    return CubeError(
        f"the disk that holds {path} is full: {wanted}{free / 1e6:.1f} MB are free. Lines stored so far are safe.",
        hint="free some space, or another disk",
    )

"""Putting shards and records where they belong: the part of the writer that runs in threads.

`CubeFiles` knows files and arrays, and nothing of slots, lines in flight or event loops; `scanhsi.cube.writer` knows nothing of
files. The order is pixels, picture and records, status, each safe before the next begins.
"""

from __future__ import annotations

import errno
import queue
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.binning import bin_lines
from scanhsi.cube.buffers import ShardBuffer
from scanhsi.cube.destination import Destination, DestinationError
from scanhsi.cube.encoding import Codec, Encoder, encoder, index_bytes
from scanhsi.cube.layout import RECORDS, STATUS, CubeSpec, Layout, LineVariable
from scanhsi.cube.metadata import ROOT, Documents, encoded, line_axes, new_cube, set_lines
from scanhsi.cube.quicklook import QuicklookMaker, QuicklookScale
from scanhsi.devices.errors import CubeError, CubeExists

__all__ = ["Codec", "CubeFiles", "Durability", "ShardRecords"]

Durability = Literal["every shard", "at close"]
"""When lines survive a power cut: as their shard is written (a line is not stored before), or when the cube is closed. A killed
process loses nothing that was stored either way."""

LANES: Final = 2
"""Shards that are encoded and written at once. Two threads keep two cores and a disk busy; more only compete."""


@dataclass(frozen=True, slots=True)
class ShardRecords:
    """What is written of some lines of one shard after their pixels.

    Attributes:
        first: First line of the shard.
        columns: Name of each per-line array -> its values from ``first`` on.
        status: uint8, from ``first`` on.
        attributes: Of the group, where they changed (``missing``, ``incidents``): written before the status.
        picture: (channel, row, column) of the quicklook, from ``first`` on; None without one.
    """

    first: int
    columns: Mapping[str, NDArray[Any]]
    status: NDArray[np.uint8]
    attributes: Mapping[str, Any] | None = None
    picture: NDArray[np.uint16] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ShardPixels:
    """Lines of one shard to be written.

    Attributes:
        first: First line of the shard.
        buffer: Its lines from the camera.
        lost: (lines,) for the lines there are, True where a line has no pixels.
        stored: (lines, band, sample) of the first lines as they were stored before the cube was resumed; None where all are new.
    """

    first: int
    buffer: ShardBuffer
    lost: NDArray[np.bool_]
    stored: NDArray[Any] | None = None


@dataclass(frozen=True, slots=True)
class _Lane:
    """What one thread needs for itself: an encoder, and room for binned lines where lines are binned."""

    encoder: Encoder
    binned: ShardBuffer | None
    picture: QuicklookMaker | None


class CubeFiles:
    """The files of one cube being written. Every method blocks.

    `write_pixels` and `write_columns` may run for several shards at once, the others once.
    """

    def __init__(
        self,
        destination: Destination,
        spec: CubeSpec,
        layout: Layout,
        codec: Codec = "lz4",
        durability: Durability = "every shard",
    ) -> None:
        self.destination = destination
        self._spec = spec
        self._stored = spec.stored
        self._layout = layout
        self._codec: Codec = codec
        self.durability: Durability = durability
        self._durable = durability == "every shard"
        self._documents: Documents = {}
        self._lanes: queue.LifoQueue[_Lane] = (
            queue.LifoQueue()
        )  # the one used last: one thread touches the memory of one

    @property
    def name(self) -> str:
        """Path or URL of the cube."""
        return self.destination.name

    def create(self, attributes: Mapping[str, Any], arrays: Documents | None = None) -> None:
        """Create the whole group at its planned size, all or nothing: it appears under its name when it is complete.

        Args:
            attributes: Of the group.
            arrays: Documents of arrays besides those of every cube.

        Raises:
            CubeExists: Something is there already; it was not touched.
            CubeError: The folder is missing, not writable, or full.
        """
        binning = self._spec.binning
        head = {"storage": self._storage, **attributes}
        if binning.factor > 1:
            head["binning"] = {"bands": binning.bands, "samples": binning.samples, "operation": "sum"}
        self._documents, files = new_cube(self._spec, self._layout, self._codec, head)
        self._documents |= arrays or {}
        try:
            self.destination.create({**files, **encoded(self._documents)})
        except FileExistsError as error:
            raise CubeExists(
                f"{self.name} exists already; nothing was written.", hint="another name, or move it away first"
            ) from error
        except NotADirectoryError as error:
            folder = self.name.rpartition("/")[0]
            raise CubeError(f"there is no folder {folder} to write into.", hint=f"mkdir -p {folder}") from error
        except OSError as error:
            raise disk_error(self.destination, error, needed=0) from error
        self._make_lanes()

    def reopen(self, documents: Documents, attributes: Mapping[str, Any]) -> None:
        """Make an interrupted cube, which is locked, ready to go on: its planned size again, and not complete.

        Raises:
            CubeError: It cannot be written.
        """
        self._documents = documents
        set_lines(documents, self._spec.lines)
        self._annotate({**attributes, "storage": self._storage})
        self._write_metadata()
        self._make_lanes()

    def attach(self, documents: Documents) -> None:
        """Write shards of a cube that is there and locked, perhaps by another process; nobody may write the same shard."""
        self._documents = documents
        self._make_lanes()

    @property
    def documents(self) -> Documents:
        """The ``zarr.json`` files as they are now."""
        return self._documents

    @property
    def _storage(self) -> dict[str, str]:
        return {"codec": self._codec, "durability": self.durability}

    def allocate(self) -> ShardBuffer:
        """A slot: memory for the lines of one shard as the camera sends them."""
        index = index_bytes(self._layout) if self._codec == "raw" else 0
        spec = self._spec
        return ShardBuffer.allocate(
            self._layout.lines_per_shard, spec.bands, spec.samples, spec.dtype, index_bytes=index
        )

    def _make_lanes(self) -> None:
        for _ in range(LANES):
            self._lanes.put(self._make_lane())

    def _make_lane(self) -> _Lane:
        spec, stored, layout = self._spec, self._stored, self._layout
        binned = picture = None
        if spec.binning.factor > 1:
            index = index_bytes(layout)
            binned = ShardBuffer.allocate(
                layout.lines_per_shard, stored.bands, stored.samples, stored.dtype, index_bytes=index
            )
        if spec.quicklook is not None:
            scale = QuicklookScale.choose(layout.lines_per_shard, spec.binning)
            picture = QuicklookMaker(spec.quicklook, spec.binning, scale)
        return _Lane(encoder(stored, layout, self._codec), binned, picture)

    def write_pixels(self, pixels: ShardPixels) -> NDArray[np.uint16] | None:
        """Write (or write anew, longer) one shard; returns its quicklook, where there is one.

        Raises:
            CubeError: It is not on disk; what was there before still is.
        """
        lane = self._lanes.get()
        try:
            return self._write_pixels(lane, pixels)
        finally:
            self._lanes.put(lane)

    def _write_pixels(self, lane: _Lane, pixels: ShardPixels) -> NDArray[np.uint16] | None:
        lines = len(pixels.lost)
        shard = lane.binned or pixels.buffer
        if lane.binned:
            bin_lines(pixels.buffer.rows[:lines], self._spec.binning, shard.rows[:lines])
        if pixels.stored is not None:
            shard.rows[: len(pixels.stored)] = pixels.stored
        picture = lane.picture.picture(shard.rows[:lines], pixels.lost) if lane.picture else None
        parts = lane.encoder.encode(shard, lines, pixels.lost)
        key = f"cube/c/0/{pixels.first // self._layout.lines_per_shard}/0"
        try:
            self.destination.put(key, parts, durable=self._durable)
        except OSError as error:
            raise disk_error(self.destination, error, needed=sum(part.nbytes for part in parts)) from error
        return picture

    def write_records(self, records: ShardRecords) -> None:
        """Write what is known of a shard's lines, then the status that says they are safe.

        Raises:
            CubeError: The status was not written.
        """
        self.write_columns(records)
        self.write_status(records)

    def write_columns(self, records: ShardRecords) -> None:
        """Write the per-line arrays and the picture of a shard. Several shards may be written at once, in any order.

        Raises:
            CubeError: Some of it was not written.
        """
        shard = records.first // self._layout.lines_per_shard
        files: dict[str, bytes] = {}
        for variable in RECORDS:
            files[f"{variable.name}/c/{shard}"] = self._line_chunk(variable, records.columns[variable.name])
        if records.picture is not None:
            files[f"quicklook/c/0/{shard}/0"] = self._picture_chunk(records.picture)
        try:
            self.destination.put_all(files, durable=self._durable)
        except OSError as error:
            raise disk_error(self.destination, error, needed=100_000) from error

    def write_status(self, records: ShardRecords) -> None:
        """Write the attributes that changed, then the status of a shard whose pixels and columns are there.

        Shard after shard, one at a time: what has a status is always a beginning of the cube.

        Raises:
            CubeError: The status was not written.
        """
        shard = records.first // self._layout.lines_per_shard
        status = self._line_chunk(STATUS, records.status)
        try:
            if records.attributes is not None:
                self._annotate(records.attributes)
                root = encoded(self._documents)[ROOT]
                self.destination.put(ROOT, [memoryview(root)], durable=self._durable)
            self.destination.put(f"status/c/{shard}", [memoryview(status)], durable=self._durable)
        except OSError as error:
            raise disk_error(self.destination, error, needed=100_000) from error

    def _line_chunk(self, variable: LineVariable, column: NDArray[Any]) -> bytes:
        """One chunk of a per-line array: uncompressed, so its file is its values.

        Through zarr the 15 arrays of a shard keep the interpreter busy for 20 ms, while the engine wants it; like this, for 7.
        """
        chunk = np.full(self._layout.lines_per_shard, variable.fill, np.dtype(variable.dtype).newbyteorder("<"))
        chunk[: len(column)] = column
        return chunk.tobytes()

    def _picture_chunk(self, picture: NDArray[np.uint16]) -> bytes:
        scale = QuicklookScale.choose(self._layout.lines_per_shard, self._spec.binning)
        rows, columns = scale.shape(self._layout.lines_per_shard, self._stored.samples)
        chunk = np.zeros((len(picture), rows, columns), "<u2")
        chunk[:, : picture.shape[1]] = picture
        return chunk.tobytes()

    def finish(self, reached: int, attributes: Mapping[str, Any]) -> None:
        """Cut the arrays to the lines reached and write the closing attributes. With durability ``at close``, sync all first.

        Raises:
            CubeError: The cube stays as it was: planned sizes, status telling what is there.
        """
        try:
            self.destination.settle()
        except OSError as error:
            raise disk_error(self.destination, error, needed=0) from error
        set_lines(self._documents, reached)
        self._annotate(attributes)
        self._write_metadata()
        self._delete_behind(reached)

    def _write_metadata(self) -> None:
        files = encoded(self._documents)
        root = files.pop(ROOT)
        try:
            self.destination.put_all(files, durable=True)
            self.destination.put(ROOT, [memoryview(root)], durable=True)
        except OSError as error:
            raise disk_error(self.destination, error, needed=100_000) from error

    def _delete_behind(self, reached: int) -> None:
        """Remove chunks that no status vouches for, of a commit that failed later; a status that was written all the same first."""
        shards = -(-reached // self._layout.lines_per_shard)
        try:
            for name, axis in sorted(line_axes(self._documents), key=lambda array: array[0] != STATUS.name):
                chunks = ((key, key.split("/")[2 + axis :]) for key in self.destination.keys(f"{name}/c"))
                self.destination.delete([key for key, at in chunks if at and at[0].isdigit() and int(at[0]) >= shards])
        except OSError as error:
            raise disk_error(self.destination, error, needed=0) from error

    def _annotate(self, attributes: Mapping[str, Any]) -> None:
        self._documents[ROOT]["attributes"] |= attributes


_HINTS: Final = {
    errno.EACCES: "permission to write there, for the user who runs this",
    errno.EPERM: "permission to write there, for the user who runs this",
    errno.EROFS: "another disk: this one is read-only, or became so after an error that the system log tells",
    errno.EIO: "another disk: this one fails; `scanhsi verify` tells what of the cube is intact",
    errno.ESTALE: "mounting the network disk anew; the scan can be resumed then",
}


def disk_error(destination: Destination, error: OSError, *, needed: int) -> CubeError:
    """An error of the file system, as the user needs to read it.

    Args:
        destination: Of the cube.
        error: What the system said.
        needed: Bytes that were to be written at once, at most; 0 where that is little.
    """
    if isinstance(error, DestinationError):
        return CubeError(f"cannot write {destination.name}: {error.strerror}.", hint=error.hint)
    if error.errno not in (errno.ENOSPC, errno.EDQUOT):
        hint = _HINTS.get(error.errno or 0, "what the system log says; the scan can be resumed when the disk is well")
        return CubeError(f"cannot write {destination.name}: {error.strerror or error}.", hint=hint)
    wanted = f"up to {needed / 1e6:.1f} MB were needed" if needed else ""
    free = destination.free_bytes()
    left = f"{free / 1e6:.1f} MB are free" if free is not None else ""
    numbers = ", ".join(part for part in (wanted, left) if part)
    return CubeError(
        f"the disk that holds {destination.name} is full{': ' + numbers if numbers else ''}. Lines stored so far are safe.",
        hint="free some space, or another disk",
    )

"""Reads the files of a cube piece by piece and says what is wrong with them, without trusting any of them.

Not through a Zarr library: libraries hand out zeros for a chunk that is not there, which is exactly what a check must notice. Only
the codecs that scanhsi writes are known. Memory is one inner chunk, raw and compressed, or a few MB of an uncompressed file.
"""

from __future__ import annotations

import math
import os
from collections.abc import Container, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import google_crc32c
import numpy as np
from numcodecs.registry import get_codec  # pyright: ignore[reportUnknownVariableType]

from scanhsi.devices.errors import CubeError

_EMPTY: Final = 2**64 - 1
"""Offset and length in the index of a shard where there is no inner chunk."""

_SLICE_BYTES: Final = 4_000_000

_BLOSC: Final = cast("Any", get_codec({"id": "blosc"}))


class Damaged(Exception):
    """A file, or a piece of it, is not what it has to be. Says why."""


@dataclass(frozen=True, slots=True, eq=False)
class ArrayFiles:
    """Where the pieces of one array are, from its metadata.

    Attributes:
        folder: Of the array.
        shape: Of the array.
        chunk: Shape of what is in one file.
        inner: Shape of what is compressed at once; the same as ``chunk`` without sharding.
        itemsize: Bytes of a value.
        codecs: Of an inner chunk, as in the metadata.
        index_codecs: Of the index of a shard; None without sharding.
        index_first: Whether the index is at the beginning of the file.
        separator: In the name of a chunk file.
    """

    folder: Path
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    inner: tuple[int, ...]
    itemsize: int
    codecs: tuple[Mapping[str, Any], ...]
    index_codecs: tuple[Mapping[str, Any], ...] | None
    index_first: bool
    separator: str

    @classmethod
    def of(cls, folder: Path, metadata: Mapping[str, Any]) -> ArrayFiles:
        """From the metadata (``zarr.json``) of an array.

        Raises:
            CubeError: It describes no array.
        """
        try:
            chunk = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
            codecs, index, first, inner = tuple(metadata["codecs"]), None, False, chunk
            if codecs[0]["name"] == "sharding_indexed":
                sharding = codecs[0]["configuration"]
                inner, codecs = tuple(sharding["chunk_shape"]), tuple(sharding["codecs"])
                index, first = tuple(sharding["index_codecs"]), sharding.get("index_location", "end") == "start"
            separator = metadata["chunk_key_encoding"].get("configuration", {}).get("separator", "/")
            itemsize = np.dtype(metadata["data_type"]).itemsize
            return cls(folder, tuple(metadata["shape"]), chunk, inner, itemsize, codecs, index, first, separator)
        except (KeyError, IndexError, TypeError, AttributeError) as error:
            raise CubeError(f"{folder / 'zarr.json'} does not describe an array: {error!r}.") from error

    @property
    def unknown_codecs(self) -> set[str]:
        """Codecs that cannot be checked here."""
        return {codec["name"] for codec in (*self.codecs, *(self.index_codecs or ()))} - set(_DECODE)

    @property
    def checksummed(self) -> bool:
        """Whether each inner chunk carries a checksum."""
        return any(codec["name"] == "crc32c" for codec in self.codecs)

    def file(self, place: Sequence[int]) -> Path:
        """File of the chunk at a place of the grid."""
        return self.folder / f"c{self.separator}{self.separator.join(map(str, place))}"

    def grid(self) -> tuple[int, ...]:
        """Number of chunk files along each axis."""
        return tuple(-(-length // piece) for length, piece in zip(self.shape, self.chunk, strict=True))

    @property
    def inner_bytes(self) -> int:
        """Decoded size of an inner chunk."""
        return math.prod(self.inner) * self.itemsize


def read_chunk(array: ArrayFiles, place: Sequence[int]) -> bytes | None:
    """The decoded contents of a small chunk file that is not sharded; None where there is no file.

    Raises:
        Damaged: It cannot be read or decoded.
    """
    try:
        data = array.file(place).read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise Damaged(f"cannot be read: {error.strerror or error}") from error
    return _decode(data, array.codecs, array.inner_bytes)


def check_file(array: ArrayFiles, place: Sequence[int], rows: Container[int], axis: int) -> Iterator[tuple[int, str]]:
    """Read and decode what one chunk file holds of some lines.

    Args:
        array: The array.
        place: Of the file in the grid.
        rows: Inner chunks wanted, counted along ``axis`` within this file.
        axis: Of lines.

    Yields:
        (row of inner chunks, what is wrong with one inner chunk of it).

    Raises:
        Damaged: The file as a whole.
    """
    with _opened(array.file(place)) as descriptor:
        if array.index_codecs is None:
            _check_whole(array, descriptor)
            return
        inner_grid = tuple(outer // piece for outer, piece in zip(array.chunk, array.inner, strict=True))
        index = _index(array, descriptor, math.prod(inner_grid)).reshape((*inner_grid, 2))
        end = os.fstat(descriptor).st_size
        for where in np.ndindex(*inner_grid):
            if where[axis] not in rows:
                continue
            try:
                _check_inner(array, descriptor, int(index[where][0]), int(index[where][1]), end)
            except Damaged as damage:
                yield where[axis], f"inner chunk {'/'.join(map(str, where))} {damage}"


def _check_inner(array: ArrayFiles, descriptor: int, offset: int, length: int, end: int) -> None:
    if offset == _EMPTY and length == _EMPTY:
        raise Damaged("is not there")
    if offset + length > end:
        raise Damaged(f"ends {offset + length - end} bytes behind the end of the file")
    _decode(_pread(descriptor, length, offset), array.codecs, array.inner_bytes)


def _check_whole(array: ArrayFiles, descriptor: int) -> None:
    """A file that is one chunk. Without compression it may be huge and is read in slices."""
    names = [codec["name"] for codec in array.codecs]
    if "blosc" in names:
        _decode(_pread(descriptor, os.fstat(descriptor).st_size, 0), array.codecs, array.inner_bytes)
        return
    summed = "crc32c" in names
    size = os.fstat(descriptor).st_size
    if size != array.inner_bytes + 4 * summed:
        raise Damaged(f"has {size} bytes instead of {array.inner_bytes + 4 * summed}")
    checksum = 0
    for offset in range(0, array.inner_bytes, _SLICE_BYTES):
        piece = _pread(descriptor, min(_SLICE_BYTES, array.inner_bytes - offset), offset)
        checksum = crc32c(piece, checksum) if summed else 0
    if summed and checksum != int.from_bytes(_pread(descriptor, 4, array.inner_bytes), "little"):
        raise Damaged("does not fit its checksum")


def _index(array: ArrayFiles, descriptor: int, chunks: int) -> np.ndarray[Any, np.dtype[np.uint64]]:
    assert array.index_codecs is not None
    size = 16 * chunks + 4 * any(codec["name"] == "crc32c" for codec in array.index_codecs)
    end = os.fstat(descriptor).st_size
    if end < size:
        raise Damaged(f"has {end} bytes, less than its index alone")
    raw = _pread(descriptor, size, 0 if array.index_first else end - size)
    try:
        return np.frombuffer(_decode(raw, array.index_codecs, 16 * chunks), "<u8")
    except Damaged as damage:
        raise Damaged(f"is torn: its index {damage}") from damage


@contextmanager
def _opened(file: Path) -> Generator[int]:
    try:
        descriptor = os.open(file, os.O_RDONLY)
    except FileNotFoundError as error:
        raise Damaged("is not there") from error
    except OSError as error:
        raise Damaged(f"cannot be opened: {error.strerror}") from error
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _pread(descriptor: int, size: int, offset: int) -> bytes:
    try:
        data = os.pread(descriptor, size, offset)
    except OSError as error:
        raise Damaged(f"cannot be read: {error.strerror}") from error
    if len(data) != size:
        raise Damaged(f"ends {size - len(data)} bytes early")
    return data


def _decode(data: bytes, codecs: Sequence[Mapping[str, Any]], size: int) -> bytes:
    for codec in reversed(codecs):
        data = _DECODE[codec["name"]](data, size)
    if len(data) != size:
        raise Damaged(f"has {len(data)} bytes instead of {size}")
    return data


def _unsummed(data: bytes, size: int) -> bytes:
    del size
    if len(data) < 4 or crc32c(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise Damaged("does not fit its checksum")
    return data[:-4]


def crc32c(data: bytes, before: int = 0) -> int:
    """Checksum of ``data``, behind what has the checksum ``before``."""
    return google_crc32c.extend(before, data)  # pyright: ignore[reportUnknownVariableType] it has no annotations


def _unblosc(data: bytes, size: int) -> bytes:
    """Decompress. The header is checked first, for the library believes the sizes in it."""
    told, packed = (int.from_bytes(data[at : at + 4], "little") for at in (4, 12))
    if len(data) < 16 or told != size or packed != len(data):
        raise Damaged("has a damaged header")
    try:
        return _BLOSC.decode(data)
    except (RuntimeError, ValueError) as error:
        raise Damaged(f"cannot be decompressed: {error}") from error


def _unchanged(data: bytes, size: int) -> bytes:
    del size
    return data


_DECODE: Final = {"bytes": _unchanged, "transpose": _unchanged, "blosc": _unblosc, "crc32c": _unsummed}


def encode(array: ArrayFiles, data: bytes) -> bytes:
    """The contents of an uncompressed chunk file.

    Raises:
        ValueError: The array is compressed.
    """
    for codec in array.codecs:
        if codec["name"] == "crc32c":
            data += crc32c(data).to_bytes(4, "little")
        elif codec["name"] != "bytes":
            raise ValueError(f"{array.folder} is not stored plainly")
    return data


def blank(array: ArrayFiles, file: Path, rows: Container[int], axis: int) -> None:
    """Take inner chunks out of the index of a shard, so that readers get zeros for them.

    Args:
        array: The array.
        file: The shard; it is changed in place, and synced.
        rows: Inner chunks, counted along ``axis``.
        axis: Of lines.

    Raises:
        Damaged: There is no index that could be changed.
        OSError: The file cannot be written.
    """
    if array.index_codecs is None:
        raise Damaged("has no index")
    inner_grid = tuple(outer // piece for outer, piece in zip(array.chunk, array.inner, strict=True))
    descriptor = os.open(file, os.O_RDWR)
    try:
        index = _index(array, descriptor, math.prod(inner_grid)).reshape((*inner_grid, 2)).copy()
        for where in np.ndindex(*inner_grid):
            if where[axis] in rows:
                index[where] = _EMPTY
        raw = index.tobytes()
        if any(codec["name"] == "crc32c" for codec in array.index_codecs):
            raw += crc32c(raw).to_bytes(4, "little")
        os.pwrite(descriptor, raw, 0 if array.index_first else os.fstat(descriptor).st_size - len(raw))
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

"""From the lines of a shard to the bytes of its file, as Zarr's ``sharding_indexed`` codec wants them.

A file is: encoded inner chunks, then an index of one (offset, length) pair of ``<u8`` per inner chunk in C order of (band, line,
sample), then the CRC32C of the index as ``<u4``. Offsets may leave gaps, so that chunks can lie where direct writes want them,
and the index at the end of the last block of 4096 bytes. An inner chunk ends in the CRC32C of what is before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final, Literal, Protocol, cast

import google_crc32c
import numpy as np
from numcodecs.registry import get_codec  # pyright: ignore[reportUnknownVariableType] - it has no annotations
from numpy.typing import NDArray
from zarr.abc.codec import BytesBytesCodec
from zarr.codecs import BloscCodec, Crc32cCodec

from scanhsi.cube.buffers import CRC_BYTES, ShardBuffer, aligned_memory, round_up
from scanhsi.cube.layout import CubeSpec, Layout

Codec = Literal["lz4", "zstd", "none", "raw"]
"""How pixels are stored: compressed fast; smaller at 1.6 times the work; not at all; not at all, and frames are never copied."""

CODECS: Final[tuple[Codec, ...]] = ("lz4", "zstd", "none", "raw")

_BLOSC: Final[dict[str, tuple[Literal["lz4", "zstd"], int, int]]] = {"lz4": ("lz4", 5, 0), "zstd": ("zstd", 1, 262_144)}
"""Name, level, blocksize."""
_BLOSC_OVERHEAD: Final = 16
_BITSHUFFLE: Final = 2
_ABSENT: Final = np.iinfo(np.uint64).max
"""Offset and length of an inner chunk that holds no line: reads as zeros."""

_crc32c = cast("Callable[[object], int]", google_crc32c.value)


def codecs_of(codec: Codec, itemsize: int) -> list[BytesBytesCodec]:
    """The codecs of an inner chunk, as zarr is told them."""
    if codec in ("none", "raw"):
        return [Crc32cCodec()]
    cname, level, blocksize = _BLOSC[codec]
    packed = BloscCodec(cname=cname, clevel=level, shuffle="bitshuffle", typesize=itemsize, blocksize=blocksize)
    return [packed, Crc32cCodec()]


def index_bytes(layout: Layout) -> int:
    """Size of a shard's index with its checksum."""
    return 16 * int(np.prod(_grid(layout))) + CRC_BYTES


def _grid(layout: Layout) -> tuple[int, ...]:
    return tuple(whole // piece for whole, piece in zip(layout.shard, layout.chunk, strict=True))


def _finish_index(index: NDArray[np.uint64], tail: NDArray[np.uint8]) -> None:
    """Put the index at the end of ``tail``, and zeros before it."""
    encoded = index.astype("<u8").tobytes()
    encoded += _crc32c(encoded).to_bytes(CRC_BYTES, "little")
    tail[: len(tail) - len(encoded)] = 0
    tail[len(tail) - len(encoded) :] = np.frombuffer(encoded, np.uint8)


def _compressor(codec: Codec) -> Callable[[NDArray[Any]], bytes] | None:
    """What compresses an inner chunk.

    In a thread that is not the main one, numcodecs runs blosc in the caller alone, without its global pool and without the GIL.
    """
    if codec not in _BLOSC:
        return None
    cname, level, blocksize = _BLOSC[codec]
    config = {"id": "blosc", "cname": cname, "clevel": level, "shuffle": _BITSHUFFLE, "blocksize": blocksize}
    return cast("Callable[[NDArray[Any]], bytes]", get_codec(config).encode)


class Encoder(Protocol):
    """Encodes one shard at a time; two threads have one each."""

    def encode(self, shard: ShardBuffer, lines: int, lost: NDArray[np.bool_]) -> list[memoryview]:
        """The contents of a shard's file.

        Args:
            shard: Its lines; those that are lost are set to zero, or ignored.
            lines: How many of them, from the first on, there are.
            lost: (lines,) where no pixels are.

        Returns:
            Pieces at multiples of 4096 bytes in memory and multiples of 4096 long, valid until the next call.
        """
        ...


def encoder(spec: CubeSpec, layout: Layout, codec: Codec) -> Encoder:
    """The encoder for a codec.

    Args:
        spec: What is stored, after binning.
        layout: Of the cube.
        codec: How.
    """
    return RawEncoder(layout) if codec == "raw" else ChunkEncoder(spec, layout, codec)


class RawEncoder:
    """Frames as they lie in memory, one an inner chunk: nothing is copied, only checksums are written between them."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout

    def encode(self, shard: ShardBuffer, lines: int, lost: NDArray[np.bool_]) -> list[memoryview]:
        """See `Encoder`. Lost lines are absent in the index, and zeros in the file."""
        index = np.full((self._layout.lines_per_shard, 2), _ABSENT, np.uint64)
        data = np.frombuffer(shard.memory, np.uint8)
        frame_bytes = shard.rows[0].nbytes
        for line in np.flatnonzero(lost[:lines]).tolist():
            data[line * shard.stride : (line + 1) * shard.stride] = 0
        for line in np.flatnonzero(~lost[:lines]).tolist():
            start, end = line * shard.stride, line * shard.stride + frame_bytes
            checksum = _crc32c(data[start:end])
            data[end : end + CRC_BYTES] = np.frombuffer(checksum.to_bytes(CRC_BYTES, "little"), np.uint8)
            index[line] = (start, frame_bytes + CRC_BYTES)
        _finish_index(index, np.frombuffer(shard.tail, np.uint8))
        return [shard.memory[: lines * shard.stride], shard.tail]


class ChunkEncoder:
    """Inner chunks of some bands, lines and samples, compressed or not, gathered in one staging buffer."""

    def __init__(self, spec: CubeSpec, layout: Layout, codec: Codec) -> None:
        self._shape = spec.shape
        self._layout = layout
        self._compress = _compressor(codec)
        self._chunk = np.zeros(layout.chunk, spec.dtype)
        bound = self._chunk.nbytes + _BLOSC_OVERHEAD + CRC_BYTES
        # Not touched in advance: what compression saves of it is never in memory.
        self._staging = aligned_memory(int(np.prod(_grid(layout))) * bound + 2 * round_up(index_bytes(layout)))
        self._bytes = np.frombuffer(self._staging, np.uint8)

    def encode(self, shard: ShardBuffer, lines: int, lost: NDArray[np.bool_]) -> list[memoryview]:
        """See `Encoder`. Lost lines are set to zero."""
        rows = shard.rows[:lines]
        rows[lost[:lines]] = 0
        index = np.full((*_grid(self._layout), 2), _ABSENT, np.uint64)
        offset = 0
        for place, piece in self._pieces(rows):
            end = self._append(offset, self._gather(piece))
            index[place] = (offset, end - offset)
            offset = end
        size = round_up(offset + index_bytes(self._layout))
        _finish_index(index, self._bytes[offset:size])
        return [self._staging[:size]]

    def _pieces(self, rows: NDArray[Any]) -> Iterator[tuple[tuple[int, ...], NDArray[Any]]]:
        """(place in the grid, (band, line, sample) view) of each inner chunk that holds a line."""
        bands, lines, samples = self._layout.chunk
        for place in np.ndindex(_grid(self._layout)):
            band, line, sample = place[0] * bands, place[1] * lines, place[2] * samples
            piece = rows[line : line + lines, band : band + bands, sample : sample + samples]
            if len(piece):
                yield place, piece.transpose(1, 0, 2)

    def _gather(self, piece: NDArray[Any]) -> NDArray[Any]:
        if piece.shape != self._chunk.shape:
            self._chunk.fill(0)
        bands, lines, samples = piece.shape
        self._chunk[:bands, :lines, :samples] = piece
        return self._chunk

    def _append(self, offset: int, chunk: NDArray[Any]) -> int:
        """Encode one inner chunk at an offset of the staging buffer; returns where it ends."""
        payload = chunk.reshape(-1).view(np.uint8) if self._compress is None else self._compress(chunk)
        end = offset + len(payload)
        self._bytes[offset:end] = np.frombuffer(payload, np.uint8)
        checksum = _crc32c(payload).to_bytes(CRC_BYTES, "little")
        self._bytes[end : end + CRC_BYTES] = np.frombuffer(checksum, np.uint8)
        return end + CRC_BYTES

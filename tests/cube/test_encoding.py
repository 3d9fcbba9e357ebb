"""The files of shards, byte by byte, and as zarr-python and tensorstore read them."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
import tensorstore
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from scanhsi.cube.buffers import ShardBuffer
from scanhsi.cube.encoding import CODECS, Codec, encoder, index_bytes
from scanhsi.cube.layout import CubeSpec, Layout, choose_layout
from scanhsi.cube.metadata import encoded, new_cube

DTYPES = ["uint8", "uint16", "uint32", "float32"]


def shard_of(spec: CubeSpec, layout: Layout, codec: Codec) -> ShardBuffer:
    shape = (layout.lines_per_shard, spec.bands, spec.samples)
    shard = ShardBuffer.allocate(*shape, spec.dtype, index_bytes=index_bytes(layout) if codec == "raw" else 0)
    rng = np.random.default_rng(3)
    shard.rows[:] = rng.integers(0, 200, shape)
    return shard


def file_of(spec: CubeSpec, layout: Layout, codec: Codec, lines: int, lost: list[int]) -> tuple[bytes, np.ndarray]:
    """A shard's file and what it ought to hold, (band, line, sample)."""
    shard = shard_of(spec, layout, codec)
    expected = shard.rows[:lines].transpose(1, 0, 2).copy()
    expected[:, lost] = 0
    mask = np.zeros(lines, bool)
    mask[lost] = True
    parts = encoder(spec, layout, codec).encode(shard, lines, mask)
    for part in parts:
        assert part.nbytes % 4096 == 0
        assert np.frombuffer(part, np.uint8).ctypes.data % 4096 == 0
    return b"".join(parts), expected


@st.composite
def shards(draw: st.DrawFn) -> tuple[CubeSpec, Layout, Codec, int, list[int]]:
    codec: Codec = draw(st.sampled_from(CODECS))
    dtype = draw(st.sampled_from(DTYPES))
    per_shard = draw(st.integers(1, 40))
    spec = CubeSpec(
        per_shard, draw(st.integers(1, 70)), draw(st.integers(1, 900)), dtype, None if dtype == "float32" else 8
    )
    lines = draw(st.integers(1, per_shard))
    lost = draw(st.lists(st.integers(0, lines - 1), unique=True, max_size=3))
    return spec, choose_layout(spec, per_shard, whole_frames=codec == "raw"), codec, lines, lost


@settings(max_examples=40, deadline=None)
@given(shards())
def test_any_shard_reads_as_plain_zarr(shard: tuple[CubeSpec, Layout, Codec, int, list[int]]) -> None:
    spec, layout, codec, lines, _ = shard
    contents, expected = file_of(*shard)
    metadata = encoded(new_cube(spec, layout, codec, {})[0])["cube/zarr.json"]
    to_buffer = default_buffer_prototype().buffer.from_bytes
    array = zarr.open_array(MemoryStore({"zarr.json": to_buffer(metadata), "c/0/0/0": to_buffer(contents)}), mode="r")
    np.testing.assert_array_equal(np.asarray(array[:, :lines]), expected)
    folder = Path(tempfile.mkdtemp())
    try:
        (folder / "c/0/0").mkdir(parents=True)
        (folder / "zarr.json").write_bytes(metadata)
        (folder / "c/0/0/0").write_bytes(contents)
        read = tensorstore.open({"driver": "zarr3", "kvstore": f"file://{folder}"}).result().read().result()
        np.testing.assert_array_equal(read[:, :lines], expected)
    finally:
        shutil.rmtree(folder)


@pytest.mark.parametrize("codec", CODECS)
def test_the_format_as_documented(codec: Any) -> None:
    """docs/reference/cube.md, read with nothing but this."""
    spec = CubeSpec(6, 40, 30, "uint16", 12)
    layout = choose_layout(spec, 6, whole_frames=codec == "raw")
    contents, expected = file_of(spec, layout, codec, 4, [1])
    grid = tuple(shard // chunk for shard, chunk in zip(layout.shard, layout.chunk, strict=True))
    size = 16 * int(np.prod(grid)) + 4
    tail = contents[-size:]
    assert int.from_bytes(tail[-4:], "little") == google_crc32c.value(tail[:-4])
    index = np.frombuffer(tail[:-4], "<u8").reshape(*grid, 2)
    for place in np.ndindex(grid):
        offset, length = (int(value) for value in index[place])
        if offset == 2**64 - 1:
            assert length == offset
            assert codec == "raw"
            assert place[1] in (1, 4, 5)  # lost, or never there
            continue
        chunk = contents[offset : offset + length]
        assert int.from_bytes(chunk[-4:], "little") == google_crc32c.value(chunk[:-4])
        if codec == "raw":
            assert offset % 4096 == 0
            np.testing.assert_array_equal(np.frombuffer(chunk[:-4], "<u2").reshape(40, 30), expected[:, place[1]])


@pytest.mark.parametrize("codec", CODECS)
def test_any_flipped_byte_of_a_chunk_is_noticed(codec: Any) -> None:
    spec = CubeSpec(3, 4, 5, "uint16", 12)
    layout = choose_layout(spec, 3, whole_frames=codec == "raw")
    contents, _ = file_of(spec, layout, codec, 3, [])
    metadata = encoded(new_cube(spec, layout, codec, {})[0])["cube/zarr.json"]
    to_buffer = default_buffer_prototype().buffer.from_bytes
    for position in (0, 7, 20, 39, 43):
        damaged = bytearray(contents)
        damaged[position] ^= 0x10
        store = MemoryStore({"zarr.json": to_buffer(metadata), "c/0/0/0": to_buffer(bytes(damaged))})
        with pytest.raises(ValueError, match="checksum"):
            zarr.open_array(store, mode="r")[:]


def test_raw_pixels_are_not_copied() -> None:
    spec = CubeSpec(4, 5, 6, "uint16", 12)
    layout = choose_layout(spec, 4, whole_frames=True)
    shard = shard_of(spec, layout, "raw")
    parts = encoder(spec, layout, "raw").encode(shard, 4, np.zeros(4, bool))
    assert np.frombuffer(parts[0], np.uint8).ctypes.data == shard.rows.ctypes.data

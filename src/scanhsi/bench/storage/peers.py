"""Writers around the libraries that others use. They are imported when asked for; not all come with scanhsi."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from scanhsi.bench.storage.work import Work
from scanhsi.bench.storage.writers import ByShards, Lines, Packing, in_threads, read_line, sync_tree
from scanhsi.cube.metadata import encoded, new_cube
from scanhsi.cube.shards import Codec

_CHUNK_BANDS: Final = 64


async def tensorstore(path: Path, work: Work, codec: Codec) -> ByShards:
    """Whole shards, two futures under way; it syncs its files itself."""
    library: Any = import_module("tensorstore")
    per_shard = _make_array(path, work, codec)
    limits = {
        "cache_pool": {"total_bytes_limit": 0},
        "data_copy_concurrency": {"limit": 2},
        "file_io_concurrency": {"limit": 2},
    }
    store = {"driver": "file", "path": f"{path}/cube/"}
    array = await library.open({"driver": "zarr3", "kvstore": store, "context": limits})

    async def write(first: int, rows: Lines, _: memoryview) -> None:
        target = array[:, first : first + len(rows), :]
        await target.write(rows.transpose(1, 0, 2), can_reference_source_data_indefinitely=True)

    return ByShards(work, per_shard, write, finish=lambda: sync_tree(path), read=_reader(path))


async def zarr_threads(path: Path, work: Work, codec: Codec, packing: Packing) -> ByShards:
    """zarr-python, called from two threads."""
    import zarr

    per_shard = _make_array(path, work, codec) if packing == "shards" else _make_chunks(path, work)
    array: Any = zarr.open_array(path / "cube", mode="r+")

    def write(first: int, rows: Lines, _: memoryview) -> None:
        array[:, first : first + len(rows), :] = rows.transpose(1, 0, 2)

    return ByShards(work, per_shard, in_threads(write), finish=lambda: sync_tree(path), read=_reader(path))


async def zarr_async(path: Path, work: Work, codec: Codec) -> ByShards:
    """zarr-python's own asyncio interface, two shards under way."""
    from zarr.api import asynchronous

    per_shard = _make_array(path, work, codec)
    array: Any = await asynchronous.open_array(store=path / "cube", mode="r+")

    async def write(first: int, rows: Lines, _: memoryview) -> None:
        here = (slice(None), slice(first, first + len(rows)), slice(None))
        await array.setitem(here, rows.transpose(1, 0, 2))

    return ByShards(work, per_shard, write, finish=lambda: sync_tree(path), read=_reader(path))


class Acquire:
    """acquire-zarr, called where the line arrives, as its users do: it copies and has its own threads."""

    def __init__(self, stream: Any, path: Path) -> None:
        self._stream = stream
        self._path = path
        self._last: Lines | None = None

    @classmethod
    async def open(cls, path: Path, work: Work, codec: Codec, packing: Packing) -> Acquire:
        """Its own axes: line, band, sample."""
        library: Any = import_module("acquire_zarr")
        layout = work.layout()
        bands, lines, samples = layout.chunk
        shards = [whole // piece for whole, piece in zip(layout.shard, layout.chunk, strict=True)]
        if packing == "chunks":
            bands, samples, shards = min(_CHUNK_BANDS, work.bands), work.samples, [1, 1, 1]

        def dimension(name: str, kind: Any, size: int, chunk: int, per_shard: int) -> Any:
            return library.Dimension(
                name=name, kind=kind, array_size_px=size, chunk_size_px=chunk, shard_size_chunks=per_shard
            )

        kinds = library.DimensionType
        settings = library.ArraySettings(
            dimensions=[
                dimension("line", kinds.TIME, 0, lines, shards[1]),
                dimension("band", kinds.SPACE, work.bands, bands, shards[0]),
                dimension("sample", kinds.SPACE, work.samples, samples, shards[2]),
            ],
            data_type=library.DataType.UINT16,
            compression=None if codec == "none" else _acquire_compression(library, codec),
        )
        return cls(library.ZarrStream(library.StreamSettings(arrays=[settings], store_path=str(path))), path)

    async def take(self, line: int, frame: Lines | None) -> None:
        """See `scanhsi.bench.storage.work.Writer`. There is no buffer that could hold a line already."""
        self._last = frame if frame is not None else self._last
        self._stream.append(self._last)

    async def finish(self) -> None:
        """Its ``close``, and a sync of what it wrote."""
        self._stream.close()
        sync_tree(self._path)

    async def close(self) -> None:
        """Nothing is left."""

    def read(self, line: int) -> Lines:
        """Through zarr-python."""
        return read_line(self._path, "", (line,))


def _acquire_compression(library: Any, codec: Codec) -> Any:
    codecs = {"lz4": (library.CompressionCodec.BLOSC_LZ4, 5), "zstd": (library.CompressionCodec.BLOSC_ZSTD, 1)}
    kind, level = codecs[codec]
    return library.CompressionSettings(compressor=library.Compressor.BLOSC1, codec=kind, level=level, shuffle=2)


def _make_array(path: Path, work: Work, codec: Codec) -> int:
    """An empty array as ours, with its checksums; lines a shard."""
    layout = work.layout()
    documents, _ = new_cube(work.spec, layout, codec, {})
    (path / "cube").mkdir(parents=True)
    (path / "cube/zarr.json").write_bytes(encoded(documents)["cube/zarr.json"])
    return layout.lines_per_shard


def _make_chunks(path: Path, work: Work) -> int:
    import zarr
    from zarr.codecs import BloscCodec

    lines = work.layout().lines_per_shard
    zarr.create_array(
        path / "cube",
        shape=work.spec.shape,
        dtype=np.uint16,
        chunks=(min(_CHUNK_BANDS, work.bands), lines, work.samples),
        compressors=BloscCodec(cname="lz4", clevel=5, shuffle="bitshuffle", typesize=2),
    )
    return lines


def _reader(path: Path) -> Callable[[int], Lines]:
    return lambda line: read_line(path, "cube", (slice(None), line))

"""The rows of the tables: who writes, how, and beside whom."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal

from scanhsi.bench.storage import peers
from scanhsi.bench.storage.work import Work, Writer
from scanhsi.bench.storage.writers import Ours, floor
from scanhsi.cube.shards import Codec, Durability

Coding = Literal["lz4", "zstd", "uncompressed"]
Make = Callable[[Path, Work], Awaitable[Writer]]
"""Makes a writer for a path."""


@dataclass(frozen=True, slots=True)
class Row:
    """A writer.

    Attributes:
        key: On the command line and in the observations.
        name: In the tables.
        coding: What its bytes are; only alike is compared.
        make: Makes it.
        note: What must be said beside the number.
        paced: It is also measured with lines as they come.
        beside: Key of ours that it is compared with; None for ours and the floor.
        needs: Module that may be missing.
        filled: See `Work`.
    """

    key: str
    name: str
    coding: Coding
    make: Make
    note: str = ""
    paced: bool = False
    beside: str | None = None
    needs: str | None = None
    filled: bool = True

    @property
    def is_there(self) -> bool:
        """Whether what it needs is installed."""
        return self.needs is None or find_spec(self.needs) is not None


def _ours(codec: Codec, note: str, *, close: bool = False, paced: bool = True) -> Row:
    durability: Durability = "at close" if close else "every shard"
    name = f"scanhsi {codec}, at close" if close else f"**scanhsi** {codec}"
    coding: Coding = "uncompressed" if codec in ("none", "raw") else codec
    make = partial(Ours.open, codec=codec, durability=durability)
    return Row(f"{codec}/close" if close else codec, name, coding, make, note, paced)


async def _floor(path: Path, work: Work, *, huge_pages: bool = True) -> Writer:
    return floor(path, work, huge_pages=huge_pages)


FLOOR: Final = "floor"
LIKE_OURS: Final = "shards, chunks, codec and checksums as ours"
OWN_AXES: Final = "(line, band, sample)"

ROWS: Final = (
    _ours("lz4", "the default"),
    Row(
        "tensorstore",
        "tensorstore lz4",
        "lz4",
        partial(peers.tensorstore, codec="lz4"),
        f"{LIKE_OURS}; its own syncs",
        paced=True,
        beside="lz4",
        needs="tensorstore",
    ),
    _ours("lz4", "", close=True),
    Row(
        "acquire",
        "acquire-zarr lz4",
        "lz4",
        partial(peers.Acquire.open, codec="lz4", packing="shards"),
        f"{OWN_AXES}; shards and chunks as ours, no checksums of chunks",
        paced=True,
        beside="lz4",
        needs="acquire_zarr",
    ),
    Row(
        "zarr",
        "zarr-python lz4",
        "lz4",
        partial(peers.zarr_threads, codec="lz4", packing="shards"),
        f"{LIKE_OURS}; from two threads",
        paced=True,
        beside="lz4",
    ),
    Row(
        "zarr/async",
        "zarr-python lz4, asyncio",
        "lz4",
        partial(peers.zarr_async, codec="lz4"),
        f"{LIKE_OURS}; its asyncio interface",
        beside="lz4",
    ),
    Row(
        "zarr/chunks",
        "zarr-python lz4, chunk files",
        "lz4",
        partial(peers.zarr_threads, codec="lz4", packing="chunks"),
        "no shards: files of 64 bands x all samples, no checksums; from two threads",
        paced=True,
        beside="lz4",
    ),
    Row(
        "acquire/chunks",
        "acquire-zarr lz4, chunk files",
        "lz4",
        partial(peers.Acquire.open, codec="lz4", packing="chunks"),
        f"{OWN_AXES}; files of 64 bands x all samples, no checksums of chunks",
        paced=True,
        beside="lz4",
        needs="acquire_zarr",
    ),
    Row(
        "tensorstore/zstd",
        "tensorstore zstd",
        "zstd",
        partial(peers.tensorstore, codec="zstd"),
        LIKE_OURS,
        beside="zstd",
        needs="tensorstore",
    ),
    _ours("zstd", ""),
    _ours("zstd", "", close=True, paced=False),
    _ours("none", "chunks as for lz4"),
    Row(
        "tensorstore/none",
        "tensorstore none",
        "uncompressed",
        partial(peers.tensorstore, codec="none"),
        LIKE_OURS,
        beside="none",
        needs="tensorstore",
    ),
    _ours("none", "", close=True, paced=False),
    Row(
        "zarr/none",
        "zarr-python none",
        "uncompressed",
        partial(peers.zarr_threads, codec="none", packing="shards"),
        f"{LIKE_OURS}; from two threads",
        beside="none",
    ),
    Row(
        "acquire/none",
        "acquire-zarr none",
        "uncompressed",
        partial(peers.Acquire.open, codec="none", packing="shards"),
        f"{OWN_AXES}; shards and chunks as ours, no checksums of chunks",
        beside="none",
        needs="acquire_zarr",
    ),
    Row(FLOOR, "floor", "uncompressed", _floor, "aligned direct writes of the same bytes, synced", paced=True),
    _ours("raw", "a frame a chunk"),
    Row(
        f"{FLOOR}/plain",
        "floor, pages of 4 kB",
        "uncompressed",
        partial(_floor, huge_pages=False),
        "the same from ordinary memory",
    ),
    _ours("raw", "", close=True),
    Row(f"{FLOOR}/there", "floor, lines not copied in", "uncompressed", _floor, "what the disk does", filled=False),
    Row(
        "raw/there",
        "**scanhsi** raw, lines not copied in",
        "uncompressed",
        partial(Ours.open, codec="raw", durability="every shard"),
        "as if the camera filled its memory",
        filled=False,
    ),
)
"""In the order in which they run: who is compared with whom runs close to it, because the load of a machine drifts."""

BY_KEY: Final = {row.key: row for row in ROWS}

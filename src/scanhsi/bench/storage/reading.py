"""What reading costs: ours, with and without dask, beside the libraries that others use, all on the same files."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi import clock
from scanhsi.bench.storage.work import Work
from scanhsi.cube.layout import choose_layout
from scanhsi.cube.reader import Chunks, open_cube
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter

Index = tuple[Any, ...]
"""Of (band, line, sample)."""
Read = Callable[[Index], NDArray[Any]]

_REGION: Final = 64
_REFERENCE_LINES: Final = 32
"""Lines a shard of the layout that was the best of those measured before this one was chosen: inner chunks of 16 x 32 x 400."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What is read.

    Attributes:
        work: The cube.
        repetitions: Warm, and as many cold.
        frames: File of the frames of its lines.
        folder: Where it is written; it is removed again.
    """

    work: Work
    repetitions: int
    frames: Path
    folder: Path


def measure_readers(reading: Reading) -> Iterator[dict[str, Any]]:
    """One observation a repetition: layout, cold or not, and ms of each kind of read for each reader."""
    shapes = [choose_layout(reading.work.spec, lines) for lines in _layouts(reading.work)]
    paths = [reading.folder / f"read-{number}.zarr" for number in range(len(shapes))]
    try:
        for path, lines in zip(paths, _layouts(reading.work), strict=True):
            clock.run(_write(path, reading, lines))
        for cold in (False, True):
            for turn in range(-1, reading.repetitions):  # the first is a warm-up
                for path, layout in zip(paths, shapes, strict=True):
                    times = _turn(path, reading.work.spec.shape, turn, cold=cold)
                    if turn >= 0:
                        shard = " x ".join(map(str, layout.shard))
                        chunk = " x ".join(map(str, layout.chunk))
                        name = f"shards {shard}, chunks {chunk}"
                        yield {"layout": name, "cold": cold, "repetition": turn, "ms": times}
    finally:
        for path in paths:
            shutil.rmtree(path, ignore_errors=True)


def _layouts(work: Work) -> list[int | None]:
    """Lines a shard: as we choose them, and as was the best of the layouts measured before."""
    ours = work.layout().lines_per_shard
    return [work.lines_per_shard] if ours == _REFERENCE_LINES else [work.lines_per_shard, _REFERENCE_LINES]


async def _write(path: Path, reading: Reading, lines_per_shard: int | None) -> None:
    frames: NDArray[np.uint16] = np.load(reading.frames)
    spec = reading.work.spec
    writer = CubeWriter(path, spec, lines_per_shard=lines_per_shard)
    await writer.open(LineRecords(spec.lines))
    for line in range(spec.lines):
        buffer = writer.buffer(line)
        if buffer is not None:
            np.copyto(buffer, np.roll(frames[line % len(frames)], line // len(frames), axis=1))
        await writer.append(line)
    await writer.close()


def reads(shape: tuple[int, int, int]) -> dict[str, Index]:
    """What is read."""
    bands, lines, samples = (length // 2 for length in shape)
    half = min(_REGION // 2, lines, samples)
    every = slice(None)
    return {
        "band": (bands, every, every),
        "spectrum": (every, lines, samples),
        "line": (every, lines, every),
        "colour": ([bands // 2, bands, bands * 3 // 2], every, every),
        "region": (every, slice(lines - half, lines + half), slice(samples - half, samples + half)),
    }


def readers(path: Path) -> dict[str, Callable[[], Read]]:
    """Those that are installed. Each opens the cube anew; what it returns reads from it."""

    def ours(chunks: Chunks) -> Read:
        pixels = open_cube(path, chunks=chunks)["cube"]
        return lambda index: pixels.isel(dict(zip(pixels.dims, index, strict=True))).values

    def through_tensorstore() -> Read:
        library: Any = import_module("tensorstore")
        store = {"driver": "file", "path": f"{path}/cube/"}
        array = library.open({"driver": "zarr3", "kvstore": store}, read=True).result()
        return lambda index: array.oindex[index].read().result()

    def through_zarr() -> Read:
        import zarr

        array: Any = zarr.open_array(path, path="cube", mode="r")
        return lambda index: np.asarray(array.oindex[index])

    def through_xarray() -> Read:
        import xarray as xr

        pixels = xr.open_zarr(path)["cube"]
        return lambda index: pixels.isel(dict(zip(pixels.dims, index, strict=True))).values

    known: dict[str, Callable[[], Read]] = {
        "open_cube, chunks=None": lambda: ours(None),
        "open_cube, dask": lambda: ours("auto"),
        "tensorstore": through_tensorstore,
        "zarr-python": through_zarr,
        "xarray.open_zarr": through_xarray,
    }
    if find_spec("tensorstore") is None:
        del known["tensorstore"]
    return known


def _turn(path: Path, shape: tuple[int, int, int], turn: int, *, cold: bool) -> dict[str, dict[str, float]]:
    """Reader -> kind of read -> ms, opening included; each turn begins with another reader. What they read must be equal."""
    names = list(readers(path))
    first = turn % len(names)
    taken: dict[str, dict[str, float]] = {name: {} for name in names}
    for what, index in reads(shape).items():
        expected: NDArray[Any] | None = None
        for name in names[first:] + names[:first]:
            if cold:
                forget(path)
            before = time.perf_counter()
            found = readers(path)[name]()(index)
            taken[name][what] = round((time.perf_counter() - before) * 1e3, 3)
            expected = found if expected is None else expected
            if not np.array_equal(found, expected):
                raise ValueError(f"{name} reads another {what} than {names[first]}")
    return taken


def forget(path: Path) -> None:
    """Drop the files of a cube, which are on disk already, from the page cache."""
    for file in path.rglob("*"):
        if file.is_file():
            descriptor = os.open(file, os.O_RDONLY)
            os.fdatasync(descriptor)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)

"""What reading a cube costs: ``python tests/benchmarks/bench_reading.py [--lines 1200] [--codec lz4] [--cold] [FOLDER]``.

Writes a cube of noisy lines, then reads a band, a spectrum, a line, a colour picture and a region of it: through `open_cube`
without and with dask, tensorstore, and zarr-python. All take turns on the same file, the best of some rounds counts; ``--cold``
drops the file from the page cache before each read, then the median does. Prints a Markdown table, ms.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tensorstore
import zarr

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter

Read = Callable[[tuple[Any, ...]], Any]


async def write(path: Path, spec: CubeSpec, codec: Any, lines_per_shard: int | None) -> None:
    """A cube of smooth spectra with the shot noise of a CMV2000, no two lines alike in their shards."""
    rng = np.random.default_rng(1)
    signal = 862 * (1 + 0.9 * np.sin(np.linspace(0, 3, spec.bands)))[:, None] * np.linspace(0.7, 1.3, spec.samples)
    noise = rng.standard_normal((16, spec.bands, spec.samples), np.float32)
    frames = np.clip(signal + noise * np.sqrt(signal / 3.3 + 16), 0, 4095).astype(np.uint16)
    records = LineRecords(spec.lines)
    writer = CubeWriter(path, spec, lines_per_shard=lines_per_shard, codec=codec)
    await writer.open(records)
    for line in range(spec.lines):
        buffer = writer.buffer(line)
        assert buffer is not None
        np.copyto(buffer, np.roll(frames[line % 16], line // 16, axis=1))
        await writer.append(line)
    await writer.close()


def reads(shape: tuple[int, int, int]) -> dict[str, tuple[Any, ...]]:
    """What is read, as an index of (band, line, sample)."""
    bands, lines, samples = (length // 2 for length in shape)
    every = slice(None)
    return {
        "band": (bands, every, every),
        "spectrum": (every, lines, samples),
        "line": (every, lines, every),
        "colour (3 bands)": ([bands // 2, bands, bands * 3 // 2], every, every),
        "region (64 x 64, all bands)": (every, slice(lines - 32, lines + 32), slice(samples - 32, samples + 32)),
    }


def readers(path: Path) -> dict[str, Callable[[], Read]]:
    """Each opens the cube anew; what it returns reads from it."""

    def ours(chunks: Any) -> Read:
        pixels = open_cube(path, chunks=chunks)["cube"]
        return lambda index: pixels.isel(dict(zip(pixels.dims, index, strict=True))).values

    def through_tensorstore() -> Read:
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": f"{path}/cube/"}}
        array = tensorstore.open(spec, read=True).result()
        return lambda index: array.oindex[index].read().result()

    def through_zarr() -> Read:
        array = zarr.open_array(path, path="cube", mode="r")
        return lambda index: np.asarray(array.oindex[index])

    return {
        "open_cube, chunks=None": lambda: ours(None),
        "open_cube, dask": lambda: ours("auto"),
        "tensorstore": through_tensorstore,
        "zarr-python": through_zarr,
    }


def forget(path: Path) -> None:
    """Drop the files of a cube from the page cache; they are on disk already."""
    for file in path.rglob("*"):
        if file.is_file():
            descriptor = os.open(file, os.O_RDONLY)
            os.fdatasync(descriptor)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)


def measure(path: Path, shape: tuple[int, int, int], rounds: int, *, cold: bool) -> dict[str, dict[str, float]]:
    """ms by reader and read, opening included."""
    taken: dict[str, dict[str, list[float]]] = {name: {what: [] for what in reads(shape)} for name in readers(path)}
    for turn in range(rounds):
        order = list(readers(path).items())
        order = order[turn % len(order) :] + order[: turn % len(order)]
        for what, index in reads(shape).items():
            for name, opener in order:
                if cold:
                    forget(path)
                before = time.perf_counter()
                opener()(index)
                taken[name][what].append((time.perf_counter() - before) * 1e3)
    best = statistics.median if cold else min
    return {name: {what: best(times) for what, times in row.items()} for name, row in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--lines", type=int, default=1200)
    parser.add_argument("--bands", type=int, default=1088)
    parser.add_argument("--samples", type=int, default=1200)
    parser.add_argument("--lines-per-shard", type=int)
    parser.add_argument("--codec", default="lz4")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="bench_reading_", dir=arguments.folder))
    try:
        path = folder / "bench.zarr"
        spec = CubeSpec(arguments.lines, arguments.bands, arguments.samples, np.uint16, 12)
        clock.run(write(path, spec, arguments.codec, arguments.lines_per_shard))
        table = measure(path, spec.shape, arguments.rounds, cold=arguments.cold)
    finally:
        shutil.rmtree(folder)
    print("| ms |", " | ".join(reads(spec.shape)), "|")
    print("|---|" + "---|" * len(reads(spec.shape)))
    for name, row in table.items():
        print(f"| {name} |", " | ".join(f"{value:.0f}" for value in row.values()), "|")


if __name__ == "__main__":
    main()

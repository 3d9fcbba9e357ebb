"""Cube writers side by side on the same lines and disk: ``python tests/benchmarks/bench_cube.py [WRITER ...] [--folder F]``.

Writers: ``lz4``, ``zstd``, ``none``, ``raw`` (ours; ``raw/close`` for durability "at close"), ``tensorstore`` and ``zarr`` (whole
shards of the same layout and codec, from threads, tensorstore with its fsync), ``floor`` (aligned direct writes of the same
bytes; ``floor-huge`` from huge pages). Each runs in a process of its own, ``--repeat`` rounds in turn. Prints a JSON line a run:
raw MB/s (last sync included), CPU seconds a raw GB, how long ``append`` blocked, peak memory. With ``--rate`` lines come at
that many a second, as from a camera; without, as fast as they are taken. Filling a line buffer is the camera's work; ``--unfilled``
leaves it out: buffers keep the lines that they got first.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import mmap
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec, choose_layout
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter

Append = Callable[[int], Awaitable[None]]
WRITERS = ["lz4", "zstd", "none", "raw", "lz4/close", "raw/close", "tensorstore", "zarr", "floor", "floor-huge"]


def synthetic_lines(bands: int, samples: int, count: int = 16) -> np.ndarray:
    """12-bit frames with the noise of a CMV2000, which is what compression has to live with: (count, band, sample).

    Full well 13.5 ke-, read noise 13 e-; smooth spectra times illumination times texture: mean near 860 DN.
    """
    rng = np.random.default_rng(1)
    gain = 13_500 / 4095
    bands_at, samples_at = np.linspace(0, 1, bands)[:, None], np.linspace(0, 1, samples)[None, :]
    spectrum = 0.25 + 0.75 * np.exp(-(((bands_at - 0.45) / 0.25) ** 2))
    light = 1 - 0.5 * (2 * samples_at - 1) ** 2
    lines = np.empty((count, bands, samples), np.uint16)
    for line in range(count):
        texture = 1 + 0.25 * np.sin(60 * samples_at + line / 9) + 0.15 * np.sin(17 * samples_at * (1 + bands_at))
        electrons = 1750 * gain * spectrum * light * texture
        noisy = electrons + rng.standard_normal((bands, samples), np.float32) * np.sqrt(electrons + 13**2)
        lines[line] = np.clip(noisy / gain, 0, 4095)
    return lines


def anonymous_mb() -> float:
    fields = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields["RssAnon"].split()[0]) / 1e3


class Peak(threading.Thread):
    """Samples the anonymous memory of this process until it is stopped."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.mb = anonymous_mb()
        self.done = threading.Event()

    def run(self) -> None:
        while not self.done.wait(0.05):
            self.mb = max(self.mb, anonymous_mb())


async def feed(
    spec: CubeSpec, lines: np.ndarray, options: argparse.Namespace, buffer: Callable[[int], Any], append: Append
) -> dict:
    blocked, late, rate = [], [], options.rate
    fill = 3 * choose_layout(spec, options.lines_per_shard).lines_per_shard if options.unfilled else spec.lines
    start = time.perf_counter()
    for line in range(spec.lines):
        if rate:
            due = start + line / rate
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            late.append(time.perf_counter() - due)
        target = buffer(line)
        if line < fill:
            np.copyto(target, lines[line % len(lines)])
        before = time.perf_counter()
        await append(line)
        blocked.append(time.perf_counter() - before)
    times = {"append_p50_ms": np.percentile(blocked, 50), "append_p99_ms": np.percentile(blocked, 99)}
    times["append_max_ms"] = max(blocked)
    if late:
        times["late_p99_ms"] = np.percentile(late, 99)
    return {name: round(float(seconds) * 1e3, 2) for name, seconds in times.items()}


async def ours(path: Path, spec: CubeSpec, lines: np.ndarray, codec: Any, options: argparse.Namespace):
    durability = "at close" if codec.endswith("/close") else "every shard"
    codec = codec.removesuffix("/close")
    writer = CubeWriter(path, spec, codec=codec, durability=durability, lines_per_shard=options.lines_per_shard)
    await writer.open(LineRecords(spec.lines))
    start, cpu = time.perf_counter(), time.process_time()

    async def append(line: int) -> None:
        await writer.append(line)

    result = await feed(spec, lines, options, writer.buffer, append)
    await writer.flush()
    if durability == "at close":
        await writer.close()
    result["measured"] = (time.perf_counter() - start, time.process_time() - cpu)
    await writer.close()
    return result


async def by_shards(path: Path, spec: CubeSpec, lines: np.ndarray, write: Any, options: argparse.Namespace):
    """Three slots, two of them being written by ``write(first, rows)``: what `CubeWriter` does, without records and status."""
    per_shard = choose_layout(spec, options.lines_per_shard).lines_per_shard
    slots = [np.zeros((per_shard, spec.bands, spec.samples), spec.dtype) for _ in range(3)]
    commits: list[asyncio.Future[None]] = []
    loop = asyncio.get_running_loop()
    start, cpu = time.perf_counter(), time.process_time()

    async def append(line: int) -> None:
        if (line + 1) % per_shard == 0 or line + 1 == spec.lines:
            first = line // per_shard * per_shard
            commits.append(loop.run_in_executor(None, write, first, slots[line // per_shard % 3][: line + 1 - first]))
            if len(commits) >= 3:
                await commits[-3]

    result = await feed(spec, lines, options, lambda line: slots[line // per_shard % 3][line % per_shard], append)
    await asyncio.gather(*commits)
    result["measured"] = (time.perf_counter() - start, time.process_time() - cpu)
    return result


def shard_metadata(path: Path, spec: CubeSpec, options: argparse.Namespace) -> None:
    """An array as ours, codec lz4 with crc32c."""
    from scanhsi.cube.metadata import encoded, new_cube

    documents, _ = new_cube(spec, choose_layout(spec, options.lines_per_shard), "lz4", {})
    (path / "cube").mkdir(parents=True)
    (path / "cube/zarr.json").write_bytes(encoded(documents)["cube/zarr.json"])


def tensorstore_write(path: Path, spec: CubeSpec, options: argparse.Namespace) -> Callable[[int, np.ndarray], None]:
    import tensorstore

    shard_metadata(path, spec, options)
    limits = {
        "cache_pool": {"total_bytes_limit": 0},
        "data_copy_concurrency": {"limit": 2},
        "file_io_concurrency": {"limit": 2},
    }
    array = tensorstore.open({"driver": "zarr3", "kvstore": f"file://{path}/cube", "context": limits}).result()

    def write(first: int, rows: np.ndarray) -> None:
        target = array[:, first : first + len(rows), :]
        target.write(rows.transpose(1, 0, 2), can_reference_source_data_indefinitely=True).result()

    return write


def zarr_write(path: Path, spec: CubeSpec, options: argparse.Namespace) -> Callable[[int, np.ndarray], None]:
    import zarr

    shard_metadata(path, spec, options)
    array = zarr.open_array(path / "cube", mode="r+")

    def write(first: int, rows: np.ndarray) -> None:
        array[:, first : first + len(rows), :] = rows.transpose(1, 0, 2)

    return write


async def floor(path: Path, spec: CubeSpec, options: argparse.Namespace, *, huge: bool) -> dict:
    """Shards of the same number of raw bytes, O_DIRECT and fdatasync, two threads, nothing else."""
    per_shard = choose_layout(spec, options.lines_per_shard).lines_per_shard
    memory = mmap.mmap(-1, -(-per_shard * spec.line_bytes // 4096) * 4096, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    if huge:
        memory.madvise(mmap.MADV_HUGEPAGE)
    np.frombuffer(memory, np.uint8).fill(1)
    path.mkdir()

    def write(shards: range) -> None:
        for shard in shards:
            descriptor = os.open(path / str(shard), os.O_WRONLY | os.O_CREAT | os.O_DIRECT)
            os.pwritev(descriptor, [memory], 0)
            os.fdatasync(descriptor)
            os.close(descriptor)

    start, cpu = time.perf_counter(), time.process_time()
    count = -(-spec.lines // per_shard)
    await asyncio.gather(*(asyncio.to_thread(write, range(lane, count, 2)) for lane in range(2)))
    return {"measured": (time.perf_counter() - start, time.process_time() - cpu)}


async def run_one(name: str, folder: Path, options: argparse.Namespace) -> dict:
    spec = CubeSpec(options.lines, options.bands, options.samples, np.uint16, 12)
    lines = synthetic_lines(spec.bands, spec.samples)
    path = folder / "bench.zarr"
    peak = Peak()
    base = peak.mb
    peak.start()
    if name == "tensorstore":
        result = await by_shards(path, spec, lines, tensorstore_write(path, spec, options), options)
    elif name == "zarr":
        result = await by_shards(path, spec, lines, zarr_write(path, spec, options), options)
    elif name.startswith("floor"):
        result = await floor(path, spec, options, huge=name == "floor-huge")
    else:
        result = await ours(path, spec, lines, name, options)
    peak.done.set()
    seconds, cpu = result.pop("measured")
    raw = spec.lines * spec.line_bytes
    return {
        "writer": name,
        "raw_mb_per_s": round(raw / seconds / 1e6, 1),
        "cpu_s_per_gb": round(cpu / raw * 1e9, 2),
        **result,
        "ratio": round(raw / sum(file.stat().st_size for file in path.rglob("*") if file.is_file()), 2),
        "memory_mb": round(peak.mb - lines.nbytes / 1e6),
        "base_mb": round(base - lines.nbytes / 1e6),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("writers", nargs="*", default=WRITERS)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--lines", type=int, default=640)
    parser.add_argument("--bands", type=int, default=1088)
    parser.add_argument("--samples", type=int, default=1200)
    parser.add_argument("--rate", type=float, default=0.0, help="lines per second; 0 is flat out; 44.8 is 117 MB/s")
    parser.add_argument("--lines-per-shard", type=int)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--unfilled", action="store_true")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    for _ in range(options.repeat):
        for name in options.writers:
            if options.inside:
                folder = Path(tempfile.mkdtemp(prefix="bench_cube_", dir=options.folder))
                try:
                    print(json.dumps(clock.run(run_one(name, folder, options))))
                finally:
                    shutil.rmtree(folder)
            else:
                rest = [word for word in sys.argv[1:] if word not in options.writers]
                subprocess.run([sys.executable, __file__, name, *rest, "--repeat", "1", "--inside"], check=True)


if __name__ == "__main__":
    main()

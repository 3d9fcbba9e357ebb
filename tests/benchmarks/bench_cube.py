"""Throughput of the cube writer: ``python tests/benchmarks/bench_cube.py [--lines 512] [--rate 0] [FOLDER]``.

Prints one JSON object: raw MB/s (after the last sync), CPU seconds a raw GB, and how long ``append`` blocked.
With ``--rate`` lines come at that many a second, as from a camera; without, as fast as they are taken.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec, choose_layout
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter


def synthetic_lines(bands: int, samples: int, count: int = 8) -> np.ndarray:
    """12-bit frames with the noise of a CMV2000, which is what compression has to live with: (count, band, sample)."""
    rng = np.random.default_rng(1)
    spectrum = 600 + 500 * np.sin(np.linspace(0, 3, bands))[:, None]
    texture = 1 + 0.3 * np.sin(np.linspace(0, 40, samples))[None, :]
    signal = spectrum * texture
    noise = rng.standard_normal((count, bands, samples), np.float32) * np.sqrt(signal / 3.3 + 16)
    return np.clip(signal + noise, 0, 4095).astype(np.uint16)


async def write(
    path: Path, spec: CubeSpec, lines: np.ndarray, rate: float, lines_per_shard: int | None, codec: str
) -> dict:
    records = LineRecords(spec.lines)
    writer = CubeWriter(path, spec, lines_per_shard=lines_per_shard, codec=codec)
    await writer.open(records)
    blocked, late = [], []
    cpu, start = time.process_time(), time.perf_counter()
    for line in range(spec.lines):
        if rate:
            due = start + line / rate
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            late.append(time.perf_counter() - due)
        buffer = writer.buffer(line)
        assert buffer is not None
        np.copyto(buffer, lines[line % len(lines)])
        before = time.perf_counter()
        await writer.append(line)
        blocked.append(time.perf_counter() - before)
    await writer.flush()
    seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    before_close = time.perf_counter()
    await writer.close()
    raw = spec.lines * spec.line_bytes
    return {
        "raw_mb_per_s": raw / seconds / 1e6,
        "cpu_s_per_gb": cpu / raw * 1e9,
        "append_p99_ms": float(np.percentile(blocked, 99)) * 1e3,
        "append_max_ms": max(blocked) * 1e3,
        "late_p99_ms": float(np.percentile(late, 99)) * 1e3 if late else None,
        "close_ms": (time.perf_counter() - before_close) * 1e3,
        "ratio": raw / sum(f.stat().st_size for f in path.rglob("*") if f.is_file()),
        "lines_per_shard": choose_layout(spec, lines_per_shard).lines_per_shard,
        "max_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def read(path: Path) -> dict:
    times = {}
    for name, index in {
        "band": {"band": 500},
        "spectrum": {"line": 100, "sample": 700},
        "line": {"line": 77},
        "three_bands": {"band": [200, 400, 600]},
    }.items():
        start = time.perf_counter()
        open_cube(path)["cube"].isel(index).load()
        times[f"read_{name}_ms"] = (time.perf_counter() - start) * 1e3
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--lines", type=int, default=256)
    parser.add_argument("--bands", type=int, default=1088)
    parser.add_argument("--samples", type=int, default=2048)
    parser.add_argument("--rate", type=float, default=0.0, help="lines per second; 0 is flat out")
    parser.add_argument("--lines-per-shard", type=int)
    parser.add_argument("--codec", default="lz4")
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="bench_cube_", dir=arguments.folder))
    try:
        spec = CubeSpec(arguments.lines, arguments.bands, arguments.samples, np.uint16, 12)
        lines = synthetic_lines(spec.bands, spec.samples)
        path = folder / "bench.zarr"
        result = clock.run(write(path, spec, lines, arguments.rate, arguments.lines_per_shard, arguments.codec))
        json.dump(result | read(path), sys.stdout, indent=1)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()

"""A cube larger than the memory of those who process it: reflectance by threads, and by one and two workers of a cluster."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.bench.storage.work import synthetic_lines
from scanhsi.calibration.reference import average
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.processing import MaskSaturated, Reflectance, Step, SubtractDark, process

pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]

LINES, BANDS, SAMPLES = 608, 1088, 1200
RAW_BYTES = 2 * LINES * BANDS * SAMPLES
LIMIT_BYTES = 1_500_000_000
"""Memory of all workers together; of the threads too."""
NEEDED_BYTES = 20e9
PLAN = {"exposure_s": 0.02, "gain_db": 0.0, "pixel_format": "Mono12"}

THREADS = """
import json, sys, time
from pathlib import Path
from scanhsi.bench.storage.work import Peak
from scanhsi.processing import process
sys.path.insert(0, sys.argv[1])
from processing.test_soak_cluster import steps
folder, threads = Path(sys.argv[2]), int(sys.argv[3])
with Peak() as peak:
    began = time.perf_counter()
    process(folder / "raw.zarr", folder / f"threads-{threads}.zarr", steps(folder), threads=threads)
    print(json.dumps({"seconds": time.perf_counter() - began, "peak_mb": peak.mb}))
"""


def write(path: Path, frames: np.ndarray, lines: int) -> None:
    spec = CubeSpec(lines, BANDS, SAMPLES, np.uint16, 12, attributes={"run": "r", "plan": PLAN, "simulated": True})

    async def main() -> None:
        writer = CubeWriter(path, spec)
        await writer.open(LineRecords(lines))
        for line in range(lines):
            buffer = writer.buffer(line)
            assert buffer is not None
            np.copyto(buffer, np.roll(frames[line % len(frames)], line // len(frames), axis=1))
            await writer.append(line)
        await writer.close()

    clock.run(main())


def steps(folder: Path) -> list[Step]:
    dark, white = average(folder / "dark.zarr"), average(folder / "white.zarr")
    return [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, tile=0.99)]


@pytest.fixture
def folder(tmp_path: Path):
    free = shutil.disk_usage(tmp_path).free
    if free < NEEDED_BYTES:
        pytest.skip(f"{tmp_path} has {free / 1e9:.0f} GB free, {NEEDED_BYTES / 1e9:.0f} are needed")
    frames = synthetic_lines(BANDS, SAMPLES, 8)
    write(tmp_path / "raw.zarr", frames, LINES)
    write(tmp_path / "dark.zarr", frames // 40, 16)
    write(tmp_path / "white.zarr", 3000 + frames // 5, 16)
    yield tmp_path
    for path in tmp_path.glob("*.zarr"):
        shutil.rmtree(path)


def by_threads(folder: Path, threads: int) -> dict[str, float]:
    words = [sys.executable, "-c", THREADS, str(Path(__file__).parents[1]), str(folder), str(threads)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def by_workers(folder: Path, workers: int) -> dict[str, float]:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=LIMIT_BYTES // 2,
            dashboard_address=None,
            host="127.0.0.1",
        ) as cluster,
        Client(cluster) as client,
    ):
        made = folder / f"workers-{workers}.zarr"
        before = client.run(os.getpid)
        began = time.perf_counter()
        process(folder / "raw.zarr", made, steps(folder), client=client)
        seconds = time.perf_counter() - began
        assert client.run(os.getpid) == before, "a worker needed more than its memory and was restarted"
        peak_kb = max(client.run(lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss).values())
    return {"seconds": seconds, "worker_mb": peak_kb * 1024 / 1e6}


def equal(one: Path, other: Path) -> bool:
    """Shard by shard, bit for bit."""
    pixels, others = (open_cube(path, chunks=None)["cube"] for path in (one, other))
    assert pixels.shape == others.shape == (BANDS, LINES, SAMPLES)
    assert pixels.dtype == np.float32
    pieces = [slice(first, first + 16) for first in range(0, LINES, 16)]
    return all(
        np.array_equal(pixels.isel(line=piece).values.view(np.uint32), others.isel(line=piece).values.view(np.uint32))
        for piece in pieces
    )


def told_of(name: str, one: dict[str, float]) -> str:
    peak = f", peak memory {one['peak_mb']:.0f} MB" if "peak_mb" in one else ""
    peak += f", peak of a worker {one['worker_mb']:.0f} MB" if "worker_mb" in one else ""
    return f"{name}: {one['seconds']:.1f} s, {RAW_BYTES / 1e6 / one['seconds']:.0f} MB/s raw{peak}"


def gain(seen: dict[str, dict[str, float]], what: str) -> float:
    return seen[f"1 {what}"]["seconds"] / seen[f"2 {what}s"]["seconds"]


def test_reflectance_of_a_cube_larger_than_memory(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert RAW_BYTES > LIMIT_BYTES

    def tell(text: str) -> None:
        with capsys.disabled():
            sys.stdout.write(f"\n{text}")
            sys.stdout.flush()

    seen = {"1 thread": by_threads(folder, 1)}
    tell(told_of("1 thread", seen["1 thread"]))
    expected = folder / "threads-1.zarr"
    assert np.isfinite(open_cube(expected, chunks=None)["cube"].isel(line=LINES // 2).values).mean() > 0.99
    runs = {"2 threads": (by_threads, 2, "threads-2"), "1 worker": (by_workers, 1, "workers-1")}
    runs["2 workers"] = (by_workers, 2, "workers-2")
    for name, (run, number, made) in runs.items():
        seen[name] = run(folder, number)
        tell(told_of(name, seen[name]))
        assert equal(folder / f"{made}.zarr", expected), name
        shutil.rmtree(folder / f"{made}.zarr")
    for what in ("thread", "worker"):
        tell(f"1 to 2 {what}s: {gain(seen, what):.2f} times")
    assert max(one.get("peak_mb", 0.0) for one in seen.values()) * 1e6 < LIMIT_BYTES

"""What viewers cost a scan: the same scan with none and with ten, one of them deaf, turn and turn about.

    python tests/benchmarks/bench_viewers.py [--rounds 3] [--lines 300] [--viewers 10] [--data FOLDER]

The server, a simulated instrument at its full size, runs in a process of its own, as do the viewers, which take every frame and
every row. Told are efficiency, lost lines, and how old a frame is when a viewer has it: from the last byte of it in the server's
memory to the last byte of its picture in the viewer's.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import socket
import statistics
import sys
import tempfile
import time
from contextlib import aclosing
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import httpx

from scanhsi.client import connect_instrument
from scanhsi.client.sockets import preview
from scanhsi.engine import ScanReport
from support.server import serving

FULL = ("camera.scene=hand",)


def look(url: str, viewers: int, go: Event, over: Event, ages: Any) -> None:
    """The viewers' process."""
    asyncio.run(_look(url, viewers, go, over, ages))


async def _look(url: str, viewers: int, go: Event, over: Event, ages: Any) -> None:
    seen: list[float] = []
    got = 0

    async def view() -> None:
        nonlocal got
        async with aclosing(preview(f"{url}/api/v1", None, 15.0)) as frames:
            async for frame in frames:
                got += frame.pixels.nbytes
                if frame.kind == "frame":
                    seen.append((time.monotonic_ns() - frame.facts["received_ns"]) * 1e-6)

    tasks = [asyncio.ensure_future(view()) for _ in range(viewers)]
    await asyncio.sleep(0.5)
    go.set()
    await asyncio.to_thread(over.wait)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    ages.put((seen, got))


def deaf_viewer(url: str) -> socket.socket:
    """One that asks for frames and never takes one."""
    address = httpx.URL(url)
    deaf = socket.create_connection((address.host, address.port or 80))
    deaf.sendall(
        f"GET /api/v1/preview HTTP/1.1\r\nHost: {address.host}:{address.port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return deaf


async def scan(url: str, name: str | None, lines: int, mode: str, exposure_s: float) -> ScanReport:
    async with connect_instrument(url, download=False) as hsi:
        plan = hsi.default_plan(lines=lines, mode=mode, exposure_s=exposure_s, pixel_format="Mono12Packed")
        return await hsi.scan(plan, name)


def measured(url: str, viewers: int, number: int, options: argparse.Namespace) -> dict[str, Any]:
    """One scan, with so many viewers."""
    name = None if options.discard else f"cube-{number}.zarr"
    if not viewers:
        report = asyncio.run(scan(url, name, options.lines, options.mode, options.exposure_s))
        return {"viewers": 0, **_told(report)}
    context = multiprocessing.get_context("spawn")
    go, over, ages = context.Event(), context.Event(), context.Queue()
    process = context.Process(target=look, args=(url, viewers - 1, go, over, ages))
    process.start()
    deaf = deaf_viewer(url)
    go.wait()
    report = asyncio.run(scan(url, name, options.lines, options.mode, options.exposure_s))
    over.set()
    seen, got = ages.get(timeout=30)
    process.join()
    deaf.close()
    quantiles = statistics.quantiles(seen, n=20) if len(seen) > 1 else [float("nan")] * 19
    return {
        "viewers": viewers,
        **_told(report),
        "frames": len(seen),
        "megabytes": round(got / 1e6, 1),
        "age_p50_ms": round(quantiles[9], 1),
        "age_p95_ms": round(quantiles[18], 1),
    }


def _told(report: ScanReport) -> dict[str, Any]:
    return {
        "efficiency": round(report.efficiency, 4),
        "period_ms": round(1e3 * report.period_s, 3),
        "regret": None if report.regret is None else round(report.regret, 4),
        "missing": report.missing,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--lines", type=int, default=300)
    parser.add_argument("--viewers", type=int, default=10)
    parser.add_argument("--mode", default="stepped")
    parser.add_argument("--exposure-s", type=float, default=0.1)
    parser.add_argument("--discard", action="store_true", help="store nothing")
    parser.add_argument("--data", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, serving(options.data or Path(folder), *FULL) as server:
        rows: list[dict[str, Any]] = []
        for number in range(2 * options.rounds):
            rows.append(measured(server.url, options.viewers * (number % 2), number, options))
            print(json.dumps(rows[-1]), flush=True)
    without, beside = (max(row["efficiency"] for row in rows if bool(row["viewers"]) is some) for some in (False, True))
    print(
        f"best efficiency without {without:.4f}, with {options.viewers} viewers {beside:.4f}: ratio {beside / without:.4f}"
    )


if __name__ == "__main__":
    main()

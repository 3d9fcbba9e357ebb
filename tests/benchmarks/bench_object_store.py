"""Writing a cube to an S3 server, beside plain puts of the same bytes: ``python tests/benchmarks/bench_object_store.py``.

Starts SeaweedFS on loopback (same cores, same disk). Each round writes with our writer, then puts the same objects, kept in memory,
with plain ``obstore.put`` from as many threads: no encoding, no order, no conditions, no lease. ``puts`` are all objects of it,
``shards`` only the pixels, ``spool`` our writer through a spool (until the scan may end, and until the server has all). Every
second round runs backwards: the disk is busy with what came before.
Prints a JSON line a run: MB/s of stored bytes, MB/s raw.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import obstore
from obstore.store import S3Store

sys.path.insert(0, str(Path(__file__).parents[1]))
from scanhsi import clock
from scanhsi.bench.storage.work import synthetic_lines
from scanhsi.cube.drain import drain
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.places import destination_of
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from support.seaweed import S3, seaweed, settings

THREADS = 2
"""Shards under way at once, as in our writer."""


async def scan(url: str, spec: CubeSpec, lines: np.ndarray, codec: Any, spool: Path | None) -> float:
    """Seconds until every line was stored and the cube closed."""
    writer = CubeWriter(destination_of(url, spool=spool), spec, codec=codec)
    await writer.open(LineRecords(spec.lines))
    start = time.perf_counter()
    for line in range(spec.lines):
        buffer = writer.buffer(line)
        assert buffer is not None
        np.copyto(buffer, lines[line % len(lines)])
        await writer.append(line)
    await writer.flush()
    await writer.close()
    return time.perf_counter() - start


def put_all(server: S3, objects: dict[str, bytes], prefix: str) -> float:
    store = S3Store(server.bucket, **settings(server))

    def put(key: str) -> None:
        obstore.put(store, f"{prefix}/{key}", objects[key], use_multipart=False)

    start = time.perf_counter()
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(put, objects))
    return time.perf_counter() - start


def measure(server: S3, spec: CubeSpec, codec: str, rounds: int, folder: Path) -> None:
    lines = synthetic_lines(spec.bands, spec.samples, 16)
    raw = spec.lines * lines[0].nbytes
    rates: dict[str, list[float]] = {}

    def tell(what: str, seconds: float, stored: int) -> None:
        rates.setdefault(what, []).append(stored / seconds / 1e6)
        row = {"codec": codec, "what": what, "stored_MB_s": stored / seconds / 1e6, "raw_MB_s": raw / seconds / 1e6}
        print(json.dumps({key: round(v, 1) if isinstance(v, float) else v for key, v in row.items()}), flush=True)

    url = f"s3://{server.bucket}/{codec}/cube.zarr"
    clock.run(scan(url, spec, lines, codec, None))  # not counted: it makes the objects
    objects = server.contents(url)
    stored = sum(map(len, objects.values()))
    shards = {key: value for key, value in objects.items() if key.startswith("cube/c/")}

    def through_spool(place: str) -> None:
        start = time.perf_counter()
        tell("spool", clock.run(scan(place, spec, lines, codec, folder / "spool")), stored)
        drain(folder / "spool")
        tell("spool, drained", time.perf_counter() - start, stored)

    ways: list[Callable[[str], None]] = [
        lambda place: tell("writer", clock.run(scan(place, spec, lines, codec, None)), stored),
        lambda place: tell("puts", put_all(server, objects, place), stored),
        lambda place: tell("shards", put_all(server, shards, place), sum(map(len, shards.values()))),
        through_spool,
    ]
    for number in range(rounds):
        for way in ways if number % 2 else reversed(ways):
            place = f"{codec}-{number}-{ways.index(way)}"
            way(place if way in ways[1:3] else f"s3://{server.bucket}/{place}/cube.zarr")
            clean(server, place)
    ratios = {what: statistics.median(of) for what, of in rates.items()}
    medians = {what: round(value, 1) for what, value in ratios.items()}
    print(
        json.dumps(
            {"codec": codec, "medians_MB_s": medians, "writer/puts": round(ratios["writer"] / ratios["puts"], 2)}
        )
    )


def clean(server: S3, prefix: str) -> None:
    store = S3Store(server.bucket, **settings(server))
    for batch in obstore.list(store, prefix):
        obstore.delete(store, [str(entry["path"]) for entry in batch])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lines", type=int, default=256)
    parser.add_argument("--bands", type=int, default=1088)
    parser.add_argument("--samples", type=int, default=1200)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--codecs", nargs="+", default=["lz4", "raw"])
    options = parser.parse_args()
    spec = CubeSpec(options.lines, options.bands, options.samples, "uint16", 12)
    with tempfile.TemporaryDirectory() as folder, seaweed(Path(folder) / "server") as server:
        os.environ.update(server.environment)
        for codec in options.codecs:
            measure(server, spec, codec, options.rounds, Path(folder))


if __name__ == "__main__":
    main()

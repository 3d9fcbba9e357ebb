"""One peer, one scan, in a process of its own: ``python worker.py MODULE FUNCTION LINES [STORE]``; prints one JSON object."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from work import SHAPE, Scan, Watch, Work, expected

WARM_UP = 200
"""Lines of a first scan that is not counted."""

PACKAGES = {
    "bluesky": "bluesky",
    "mm_test_adapters": "mm-test-adapters",
    "ome_writers": "ome-writers",
    "openhsi": "openhsi",
    "ophyd_async": "ophyd-async",
    "pymmcore": "pymmcore",
    "pymmcore_plus": "pymmcore-plus",
    "scanhsi": "scanhsi",
    "tensorstore": "tensorstore",
    "useq": "useq-schema",
    "zarr": "zarr",
}
"""Module -> its distribution, where its version matters."""


def main() -> None:
    module, function, lines, *store = sys.argv[1:]
    out = os.dup(1)
    os.dup2(2, 1)  # whatever a peer prints is not the result
    scan = getattr(importlib.import_module(module), function)
    path = Path(store[0]) if store else None
    _timed(scan, Work(WARM_UP, path))
    watch = _timed(scan, Work(int(lines), path))
    periods_ns = np.diff(watch.ends_ns).tolist()
    result = {"wall_ns": watch.wall_ns, "cpu_ns": watch.cpu_ns, "periods_ns": periods_ns, "versions": _versions()}
    os.write(out, json.dumps(result).encode())
    sys.stdout.flush()
    os._exit(0)  # engines keep threads and loops that take their time to end


def _timed(scan: Scan, work: Work) -> Watch:
    watch = Watch()
    try:
        stored = scan(work, watch)
        _check(work, watch, stored, own_pixels=scan.__module__ in ("ours", "floor", "run_engine"))
    finally:
        if work.store is not None:
            shutil.rmtree(work.store, ignore_errors=True)
    return watch


def _check(work: Work, watch: Watch, stored: np.ndarray | None, *, own_pixels: bool) -> None:
    """A line that was lost, or stored wrong, makes no number."""
    if len(watch.ends_ns) != work.lines:
        raise SystemExit(f"{len(watch.ends_ns)} lines were taken, not {work.lines}")
    if work.store is None:
        return
    if stored is None or stored.shape != (work.lines, *SHAPE) or stored.dtype != np.uint16:
        raise SystemExit(f"stored was {None if stored is None else (stored.shape, stored.dtype)}")
    if own_pixels and not np.array_equal(stored, expected(work.lines)):
        raise SystemExit("what was stored is not what was taken")
    if not own_pixels and not stored.any(axis=(1, 2)).all():
        raise SystemExit("a stored line is empty")


def _versions() -> dict[str, str]:
    return {package: version(package) for module, package in PACKAGES.items() if module in sys.modules}


if __name__ == "__main__":
    main()

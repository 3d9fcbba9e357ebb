"""Observations to Markdown."""

from __future__ import annotations

from typing import Any

import numpy as np
from rows import OURS, OURS_STORED, ROWS, RUN_ENGINE, RUN_ENGINE_STORED, Row

HEAD = (
    "| system | p50 ms | p99 ms | whole scan, ms a line | CPU ms a line | time / ours | CPU / ours "
    "| what it does, what is not comparable |\n|---|---|---|---|---|---|---|---|"
)
Scans = dict[str, list[dict[str, Any]]]
"""Row key -> its scans, one a repetition, in order."""


def markdown(scans: Scans) -> str:
    """Both tables, and what they say of the demand."""
    parts = [
        "### Step scan, devices that do nothing",
        *_table(scans, stored=False),
        "",
        "### The same with a frame of 64 x 512 u16 a line, stored to Zarr",
        *_table(scans, stored=True),
        "",
        _verdict(scans, RUN_ENGINE, OURS, "nothing stored"),
        _verdict(scans, RUN_ENGINE_STORED, OURS_STORED, "frames stored"),
    ]
    return "\n".join(parts)


def _table(scans: Scans, *, stored: bool) -> list[str]:
    ours = scans[OURS_STORED if stored else OURS]
    return ["", HEAD, *(_line(row, scans[row.key], ours) for row in ROWS if row.stored is stored)]


def _line(row: Row, seen: list[dict[str, Any]], ours: list[dict[str, Any]]) -> str:
    good = [scan for scan in seen if "error" not in scan]
    if len(good) < len(seen) or not seen:
        reason = next((scan["error"] for scan in seen if "error" in scan), "not run")
        return f"| {row.name} | – | – | – | – | – | – | did not run here: {reason.replace('|', '/')} |"
    cells = [
        _spread([np.percentile(scan["periods_ns"], 50) * 1e-6 for scan in good]),
        _spread([np.percentile(scan["periods_ns"], 99) * 1e-6 for scan in good]),
        _spread([per_line(scan, "wall_ns") for scan in good]),
        _spread([per_line(scan, "cpu_ns") for scan in good]),
        *(("–", "–") if row.on_disk else (f"{ratio(good, ours, what):.2g}" for what in ("wall_ns", "cpu_ns"))),
    ]
    return f"| {row.name} | {' | '.join(cells)} | {row.note} |"


def per_line(scan: dict[str, Any], what: str) -> float:
    """ms a line."""
    return scan[what] * 1e-6 / scan["lines"]


def ratio(peer: list[dict[str, Any]], ours: list[dict[str, Any]], what: str) -> float:
    """Median of the ratios within each repetition; NaN where ours did not run."""
    pairs = [(per_line(p, what), per_line(o, what)) for p, o in zip(peer, ours, strict=False) if "error" not in o]
    return float(np.median([theirs / our for theirs, our in pairs])) if pairs else float("nan")


def _spread(values: list[float]) -> str:
    middle, low, high = np.median(values), min(values), max(values)
    return f"{middle:.3g} ({low:.2g}–{high:.2g})"


def _verdict(scans: Scans, peer: str, ours: str, work: str) -> str:
    if any("error" in scan for key in (peer, ours) for scan in scans[key]) or not scans[ours]:
        return f"* RunEngine step scan / scanhsi, {work}: not measured."
    time, cpu = (ratio(scans[peer], scans[ours], what) for what in ("wall_ns", "cpu_ns"))
    return f"* RunEngine step scan / scanhsi, {work}: {time:.1f} times the time, {cpu:.1f} times the CPU time a line."

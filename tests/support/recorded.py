"""Recorded profiles out of arrays, and a writer that has bursts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.records import STAGES
from scanhsi.timing.bounds import LineDelays
from scanhsi.timing.delays import DelayProfile, Stream
from scanhsi.timing.recording import Recording, profile_of

Ns = NDArray[np.int64]
MS = 1_000_000


def recorded(
    *scans: dict[Stream, Ns], steps: int = 1, pixel_format: str = "Mono8", mode: str = "stepped"
) -> DelayProfile:
    """A profile of scans with these delays; -1 where a line has none."""
    taken = [stamped(delays, steps=steps, pixel_format=pixel_format, mode=mode) for delays in scans]
    return profile_of(taken, name="recorded", source="a test", mark="measured")


def stamped(
    delays: dict[Stream, Ns], *, steps: int = 1, pixel_format: str = "Mono8", mode: str = "stepped"
) -> Recording:
    """The stamps of a scan that met these delays: T_act, T_rx, T_mcpy and T_store, each line on its own, an hour apart."""
    lines = len(next(iter(delays.values())))
    absent = np.iinfo(np.int64).min
    begin = np.arange(1, lines + 1, dtype=np.int64) * 3_600_000_000_000
    columns = {stage: np.full(lines, absent) for stage in STAGES}
    pairs = {
        "T_act": ("commanded", "moved"),
        "T_rx": ("exposure_end", "received"),
        "T_mcpy": ("received", "copied"),
        "T_store": ("copied", "stored"),
    }
    for stream, (first, last) in pairs.items():
        if stream in delays:
            column = delays[stream]
            here = np.where(columns[first] == absent, begin, columns[first])
            columns[first] = np.where(column < 0, columns[first], here)
            columns[last] = np.where(column < 0, absent, here + column)
    return Recording(columns, 10 * MS, pixel_format, steps, mode, "a run")


def bursty_store(lines: int, seed: int) -> Ns:
    """Times to store a line: 2.5 ms and a little more; in bursts of 12 lines on average, one in 300 lines, 26 ms and more."""
    generator = np.random.default_rng(seed)
    turn = generator.random(lines)
    slow = np.zeros(lines, np.bool_)
    for line in range(1, lines):
        slow[line] = turn[line] > 1 / 12 if slow[line - 1] else turn[line] < 1 / 300
    long, short = 26 + generator.exponential(10, lines), 2.5 + generator.exponential(1, lines)
    return np.rint(np.where(slow, long, short) * MS).astype(np.int64)


def storing(store: Ns, buffers: int) -> LineDelays:
    """A sweep of which only storing takes long."""
    none = np.zeros_like(store)
    return LineDelays(
        exposure=none + 10 * MS,
        actuate=none,
        trigger=none,
        transfer=none + 18 * MS,
        copy=none + MS // 2,
        store=store,
        readout_ns=0,
        dead_ns=0,
        overlap=True,
        buffers=16,
        line_buffers=buffers,
    )

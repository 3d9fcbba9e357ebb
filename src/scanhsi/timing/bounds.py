"""The shortest line period that given delays allow, and how far a scan stayed above it.

The events of a line (settled, exposure start S and end E, received X, copied C, stored W) form a timed event graph without
decisions, so its as-soon-as-possible schedule is the least solution of a (max, +) recursion and componentwise earliest: no engine
can be faster for the same realised delays (Baccelli, Cohen, Olsder, Quadrat, *Synchronization and Linearity*). Hence

    regret = measured period / period of that schedule >= 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ns = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LineDelays:
    """Realised delays of the lines of one scan: int64 arrays of equal length in ns.

    Attributes:
        exposure: Exposure time.
        actuate: Move to the line and settle; entry 0 does not count.
        trigger: From sending the trigger to the start of exposure.
        transfer: Time the frame holds the link.
        copy: Unpacking into the line buffer.
        store: Handing the line over to storage.
        readout_ns: Sensor read-out.
        dead_ns: Between one exposure and the next, for a sensor that overlaps read-out and exposure.
        overlap: Whether it does.
        buffers: Frame buffers of the camera: a line is not exposed before the one so many lines earlier is unpacked. Where a slow
            link or copy sets the pace, this is how it does.
    """

    exposure: Ns
    actuate: Ns
    trigger: Ns
    transfer: Ns
    copy: Ns
    store: Ns
    readout_ns: int
    dead_ns: int
    overlap: bool
    buffers: int


def earliest_starts(delays: LineDelays, mode: str) -> Ns:
    """Earliest possible exposure starts.

    Args:
        delays: Of n lines.
        mode: ``sequential``, ``stepped`` or ``continuous``.

    Returns:
        int64 (n,), ns; line 0 starts at 0.
    """
    starts: list[int] = []
    unpacked: list[int] = []
    exposed = received = copied = stored = read = 0
    last_exposure = 0
    columns = (delays.exposure, delays.actuate, delays.trigger, delays.transfer, delays.copy, delays.store)
    for line, (exposure, actuate, trigger, transfer, copy, store) in enumerate(
        zip(*(column.tolist() for column in columns), strict=True)
    ):
        if line == 0:
            start = 0
        else:
            sensor = max(exposed + delays.dead_ns, read - last_exposure) if delays.overlap else read
            ready = {"sequential": stored + actuate, "stepped": exposed + actuate}.get(mode, 0)
            free = unpacked[line - delays.buffers] if line >= delays.buffers else 0
            start = max(sensor, max(ready, free) + trigger if mode != "continuous" else free)
        exposed = start + exposure
        read = exposed + delays.readout_ns
        received = max(exposed, received) + transfer
        copied = max(received, copied) + copy
        unpacked.append(copied)
        stored = max(copied, stored) + store
        last_exposure = exposure
        starts.append(start)
    return np.array(starts, np.int64)


def mean_period_ns(starts: Ns) -> float:
    """Mean distance of successive exposure starts; nan for fewer than two lines."""
    return float(starts[-1] - starts[0]) / (len(starts) - 1) if len(starts) > 1 else float("nan")


@dataclass(frozen=True, slots=True)
class Bound:
    """How close a scan came to what its delays allow.

    Attributes:
        period_s: Period of the earliest schedule.
        regret: Measured period over it, by the theorem at least 1.
    """

    period_s: float
    regret: float


def bound(starts: Ns, delays: LineDelays, mode: str) -> Bound | None:
    """Compare measured exposure starts with the earliest ones for the same delays.

    None where there is nothing to compare: fewer than two lines, or delays that are all zero.

    Args:
        starts: int64 (n,), measured exposure starts, ns.
        delays: Of the same lines.
        mode: As in `earliest_starts`.

    All lines count, also those of the filling pipeline: from line 0 on the theorem holds to the letter.
    """
    earliest = mean_period_ns(earliest_starts(delays, mode))
    if not earliest > 0:
        return None
    return Bound(period_s=earliest * 1e-9, regret=mean_period_ns(starts) / earliest)

"""The shortest line period that given delays allow, and how far a scan stayed above it.

The events of a line (settled, exposure start S and end E, received X, copied C, stored W) form a timed event graph without
decisions, so its as-soon-as-possible schedule is the least solution of a (max, +) recursion and componentwise earliest: no engine
can be faster for the same realised delays (Baccelli, Cohen, Olsder, Quadrat, *Synchronization and Linearity*). Hence

    regret = time that the scan took / time of that schedule >= 1,

both from the first exposure to the last line delivered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Ns = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LineDelays:
    """Realised delays of the lines of one scan: int64 arrays of equal length in ns.

    What only a model knows, not the stamps of a scan, has a default without effect; so a bound from stamps stays a bound.

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
        event: End of exposure until the host knows it; None for no time.
        first_row_ns: End of exposure to the first row on the wire.
        whole_frame: A frame is not received before it is read out.
        line_buffers: Line buffers of storage: a line is not exposed before the one so many lines earlier is stored; None for any
            number.
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
    event: Ns | None = None
    first_row_ns: int = 0
    whole_frame: bool = False
    line_buffers: int | None = None


@dataclass(frozen=True, slots=True)
class Schedule:
    """Earliest possible times of each line, int64 (n,), ns; line 0 is exposed from 0 on.

    Attributes:
        starts: Exposure begins.
        received: The frame has come.
        copied: It is unpacked.
        stored: It is handed over to storage.
    """

    starts: Ns
    received: Ns
    copied: Ns
    stored: Ns


def earliest(delays: LineDelays, mode: str) -> Schedule:
    """The earliest schedule: the least solution of the recursion.

    Args:
        delays: Of n lines.
        mode: ``sequential``, ``stepped`` or ``continuous``.
    """
    rows: list[tuple[int, int, int, int]] = []
    exposed = told = received = copied = stored = read = 0
    last_exposure = 0
    event_column = np.zeros_like(delays.exposure) if delays.event is None else delays.event
    columns = (
        delays.exposure,
        delays.actuate,
        delays.trigger,
        event_column,
        delays.transfer,
        delays.copy,
        delays.store,
    )
    camera, storage = delays.buffers, delays.line_buffers
    for line, (exposure, actuate, trigger, event, transfer, copy, store) in enumerate(
        zip(*(column.tolist() for column in columns), strict=True)
    ):
        if line == 0:
            start = 0
        else:
            sensor = max(exposed + delays.dead_ns, read - last_exposure) if delays.overlap else read
            ready = {"sequential": stored + actuate, "stepped": told + actuate}.get(mode, 0)
            free = rows[line - camera][2] if line >= camera else 0
            if storage is not None and line >= storage:
                free = max(free, rows[line - storage][3])
            start = max(sensor, max(ready, free) + trigger if mode != "continuous" else free)
        exposed = start + exposure
        told = exposed + event if mode != "continuous" else exposed
        read = exposed + delays.readout_ns
        received = max(exposed + delays.first_row_ns, received) + transfer
        if delays.whole_frame:
            received = max(received, read)
        copied = max(received, told, copied) + copy
        stored = max(copied, stored) + store
        last_exposure = exposure
        rows.append((start, received, copied, stored))
    table = np.array(rows, np.int64).reshape(-1, 4)
    return Schedule(*(np.ascontiguousarray(column) for column in table.T))


def earliest_starts(delays: LineDelays, mode: str) -> Ns:
    """Earliest possible exposure starts.

    Args:
        delays: Of n lines.
        mode: ``sequential``, ``stepped`` or ``continuous``.

    Returns:
        int64 (n,), ns; line 0 starts at 0.
    """
    return earliest(delays, mode).starts


def mean_period_ns(starts: Ns) -> float:
    """Mean distance of successive exposure starts; nan for fewer than two lines."""
    return float(starts[-1] - starts[0]) / (len(starts) - 1) if len(starts) > 1 else float("nan")


@dataclass(frozen=True, slots=True)
class Bound:
    """How close a scan came to what its delays allow.

    Attributes:
        period_s: Line period of the earliest schedule, between lines delivered.
        regret: Time from the first exposure to the last line delivered, over that of the earliest schedule; by the theorem at
            least 1.
    """

    period_s: float
    regret: float


def bound(starts: Ns, delivered: Ns, delays: LineDelays, mode: str) -> Bound | None:
    """Compare a scan with the earliest schedule for the same delays.

    What counts is when lines were delivered, not when they were exposed: with buffers behind it a camera exposes the first lines
    faster than they can leave it, and a sweep, which has one speed, does not; neither says when the scan is over.

    None where there is nothing to compare: fewer than two lines, none delivered, or delays that are all zero.

    Nothing holds a sweep back, so its exposures can run ahead of the host's buffers as long as the camera's own memory takes the
    frames, or they are lost: a sweep that did so is compared with what it could do with any number of buffers.

    Args:
        starts: int64 (n,), measured exposure starts, ns.
        delivered: int64 (n,), when each of these lines was unpacked in the host's memory, ns; the least int64 where it was lost.
        delays: Of the same lines.
        mode: As in `earliest_starts`.
    """
    arrived = np.flatnonzero(delivered != np.iinfo(np.int64).min)
    if len(starts) < 2 or not len(arrived):
        return None
    last = int(arrived[-1])
    measured = int(delivered[last] - starts[0])
    copied = earliest(delays, mode).copied
    if mode == "continuous" and measured < copied[last]:
        copied = earliest(replace(delays, buffers=len(starts) + 1, line_buffers=None), mode).copied
    if not copied[last] > 0:
        return None
    return Bound(period_s=mean_period_ns(copied) * 1e-9, regret=measured / int(copied[last]))


def price_of_mode(delays: LineDelays, mode: str) -> float:
    """What the choice of a mode costs, however good the engine: its period over that of a continuous scan with the same delays."""
    return mean_period_ns(earliest(delays, mode).stored) / mean_period_ns(earliest(delays, "continuous").stored)


def price_of_buffers(delays: LineDelays, mode: str) -> float:
    """What a bounded number of buffers costs: the period with these over that with as many as there are lines.

    Periods are taken where lines are stored: without limit to the buffers a slow link does not hold up the exposures.
    """
    unbounded = replace(delays, buffers=len(delays.exposure) + 1, line_buffers=None)
    return mean_period_ns(earliest(delays, mode).stored) / mean_period_ns(earliest(unbounded, mode).stored)

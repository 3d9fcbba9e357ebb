"""From the stamps of a scan to the durations of its stages and the delays of its devices.

Stamps are int64 columns in ns, one entry a line, `numpy.iinfo(int64).min` where a stamp was never taken (see
``scanhsi.cube.records``). A stage is given by its stamps; where one is absent the stage is left out for that line.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scanhsi.timing.bounds import LineDelays

Stamps = Mapping[str, NDArray[np.int64]]

_ABSENT = np.iinfo(np.int64).min
_WARM_UP = 5

_STAGES = {
    "move": ("commanded", "moved"),
    "trigger": ("trigger", "exposure_start"),
    "exposure": ("exposure_start", "exposure_end"),
    "transfer": ("exposure_end", "received"),
    "copy": ("received", "copied"),
    "store": ("copied", "stored"),
}


@dataclass(frozen=True, slots=True)
class StageTime:
    """Duration of one stage over all lines, in s."""

    mean_s: float
    p50_s: float
    p99_s: float
    max_s: float


def stage_times(stamps: Stamps, breaks: Iterable[int] = ()) -> dict[str, StageTime]:
    """Time per line and stage: move, trigger, exposure, transfer, copy, store, and the whole line.

    ``line`` is the distance of successive `deliveries`.

    Args:
        stamps: Of one scan.
        breaks: Lines before which something kept the scan from going on: that time is none of a line.
    """
    times = {stage: _elapsed(stamps[first], stamps[last]) for stage, (first, last) in _STAGES.items() if last in stamps}
    stretches = [np.diff(deliveries(stretch)) for stretch in between(stamps, breaks)]
    times["line"] = np.concatenate(stretches)
    return {stage: _summary(values) for stage, values in times.items() if len(values)}


def between(stamps: Stamps, breaks: Iterable[int]) -> list[Stamps]:
    """The stamps of each stretch between breaks."""
    lines = len(stamps["received"])
    edges = sorted({0, lines, *(line for line in breaks if 0 < line < lines)})
    return [{stage: column[first:last] for stage, column in stamps.items()} for first, last in pairwise(edges)] or [
        stamps
    ]


def exposure_starts(stamps: Stamps) -> NDArray[np.int64]:
    """Exposure starts of the lines that have one, in ns; arrivals where the driver could not tell any start."""
    for stage in ("exposure_start", "received"):
        column = stamps[stage]
        present = column[column != _ABSENT]
        if len(present):
            return present
    return np.empty(0, np.int64)


def delivered(stamps: Stamps) -> NDArray[np.int64]:
    """When each line was in the host's memory, unpacked where it was, in ns; the least int64 where it never came."""
    copied = stamps["copied"]
    return copied if (copied != _ABSENT).any() else stamps["received"]


def deliveries(stamps: Stamps) -> NDArray[np.int64]:
    """When each line that arrived was in the host's memory, unpacked where it was: int64 (n,), ns, in order.

    The time between two of them is what a line costs: *the* line period of reports, ``scanhsi info`` and benchmarks. Exposure
    starts are no measure of that: a camera with memory of its own takes the first lines faster than they can leave it. The first
    lines, a quarter but at most 5, are left out: caches are cold, and one frame that comes late there would shorten the mean of
    all that follow.
    """
    times = delivered(stamps)
    arrived = times[times != _ABSENT]
    return arrived[min(_WARM_UP, len(arrived) // 4) :]


def delays_of(
    stamps: Stamps,
    *,
    exposure_ns: int,
    readout_ns: int,
    dead_ns: int,
    overlap: bool,
    buffers: int,
    look_ahead: bool = False,
) -> tuple[NDArray[np.int64], LineDelays]:
    """The device delays that a scan met, for `scanhsi.timing.bounds.bound`.

    What the engine or a safety margin added is *not* a device delay: an exposure counts as ``exposure_ns`` even where its end was
    timed with a margin, a copy from when both frame and copier were ready, storing only as far as the next line waited for it. A
    delay that was not stamped counts as 0, which keeps the bound a bound.

    With look-ahead a move counts from the moment the mirror began to move, but not from before the nominal end of the exposure: the
    bound is the period of an engine that knows every latency beforehand. Where a motion began too early, which flags the line as
    smeared, the time won by that is granted to the bound.

    Args:
        stamps: Of one scan.
        exposure_ns: Exposure time as applied.
        readout_ns: Sensor read-out.
        dead_ns: Dead time between overlapping exposures.
        overlap: Whether the sensor overlaps exposure and read-out.
        buffers: Frame buffers of the camera.
        look_ahead: Moves were sent before the exposure had ended.

    Returns:
        Measured exposure starts of the lines that were exposed, int64 (n,), and the delays of those lines.
    """
    exposed = stamps["exposure_start"] != _ABSENT
    column = {name: values[exposed] for name, values in stamps.items()}
    count = int(np.count_nonzero(exposed))
    previous = np.concatenate(([_ABSENT], column["copied"][:-1])) if count else column["copied"]
    ready = np.maximum(column["received"], previous)
    following = np.concatenate((column["commanded"][1:], [_ABSENT])) if count else column["commanded"]
    waited_for = np.where(following == _ABSENT, column["stored"], np.minimum(column["stored"], following))
    return column["exposure_start"], LineDelays(
        exposure=np.full(count, exposure_ns, np.int64),
        actuate=_delay(_begun(column, exposure_ns) if look_ahead else column["commanded"], column["moved"]),
        trigger=_delay(column["trigger"], column["exposure_start"]),
        transfer=_delay(column["first_byte"], column["received"]),
        copy=_delay(ready, column["copied"]),
        store=_delay(column["copied"], waited_for),
        readout_ns=readout_ns,
        dead_ns=dead_ns,
        overlap=overlap,
        buffers=buffers,
    )


def _begun(column: Stamps, exposure_ns: int) -> NDArray[np.int64]:
    """From when on a move counts, with look-ahead."""
    ended = np.concatenate(([_ABSENT], column["exposure_start"][:-1] + exposure_ns))[: len(column["started"])]
    return np.where(column["started"] == _ABSENT, column["commanded"], np.maximum(column["started"], ended))


def _delay(first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.int64]:
    absent = (first == _ABSENT) | (last == _ABSENT)
    return np.where(absent, 0, np.maximum(last - np.where(absent, 0, first), 0))


def _elapsed(first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.int64]:
    both = (first != _ABSENT) & (last != _ABSENT)
    return last[both] - first[both]


def _summary(values: NDArray[np.int64]) -> StageTime:
    p50, p99 = np.percentile(values, [50, 99]).tolist()
    return StageTime(
        mean_s=float(values.mean()) * 1e-9, p50_s=p50 * 1e-9, p99_s=p99 * 1e-9, max_s=float(values.max()) * 1e-9
    )

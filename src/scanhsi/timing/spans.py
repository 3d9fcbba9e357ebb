"""When each stage of a scan was busy, and how much of a line's time it alone accounts for.

A stage works on one line at a time and on lines in order, so waiting for its predecessor is not work: a span begins when
both the line and the stage were ready. Spans of one stage therefore never overlap; spans of different stages do, and that is the
point of a pipelined scan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanhsi.timing.observed import Stamps, deliveries

_ABSENT = np.iinfo(np.int64).min

_STAGES = {
    "exposure": ("exposure_start", "exposure_end"),
    "move": ("commanded", "moved"),
    "transfer": ("exposure_end", "received"),
    "copy": ("received", "copied"),
    "store": ("copied", "stored"),
}
"""Stage -> stamps of its begin and end; the order is that in which stages account for a time that several share."""

STAGES = tuple(_STAGES)


@dataclass(frozen=True, slots=True)
class Spans:
    """When one stage was busy; loop clock.

    Attributes:
        line: int64 (n,), line of each span, in order.
        begin: int64 (n,), ns.
        end: int64 (n,), ns; never before its begin.
        waited: int64 (n,), ns for which the line had waited for the stage at ``begin``.
    """

    line: NDArray[np.int64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    waited: NDArray[np.int64]

    @property
    def busy_ns(self) -> int:
        """Sum of all spans."""
        return int((self.end - self.begin).sum())


def stage_spans(stamps: Stamps) -> dict[str, Spans]:
    """Spans of every stage that was stamped: exposure, move, transfer, copy, store.

    A transfer counts from the first byte where the driver knows it, else from the end of exposure.

    Args:
        stamps: Columns of a scan, `scanhsi.cube.records.STAGES`.
    """
    spans = {stage: _spans(stage, stamps) for stage in _STAGES}
    return {stage: found for stage, found in spans.items() if len(found.line)}


def _spans(stage: str, stamps: Stamps) -> Spans:
    first, last = _STAGES[stage]
    ready, ended = stamps[first], stamps[last]
    if stage == "transfer":
        ready = np.where(stamps["first_byte"] == _ABSENT, ready, stamps["first_byte"])
    line = np.flatnonzero((ready != _ABSENT) & (ended != _ABSENT))
    ready, ended = ready[line], ended[line]
    free = np.maximum.accumulate(np.concatenate(([_ABSENT], ended)))[:-1]
    begin = np.minimum(np.maximum(ready, free), ended)
    return Spans(line.astype(np.int64), begin, ended, begin - np.minimum(ready, begin))


@dataclass(frozen=True, slots=True)
class Share:
    """What one stage costs a line, in s on average.

    Attributes:
        alone_s: In which it accounts for the time, because no stage before it in `STAGES` was busy.
        hidden_s: In which it was busy behind a stage that accounts for the time.
    """

    alone_s: float
    hidden_s: float


def shares(stamps: Stamps) -> dict[str, Share]:
    """Divide the time from the first of `deliveries` to the last among the stages, per line.

    The ``alone_s`` of all stages and of ``waiting``, in which nothing was busy, add up to the line period. What overlaps is in
    ``hidden_s``: time that an instrument which does everything in turn would have to add (Fig. 5). Only for ``store`` that is not
    work alone: lines become safe in batches, and a line that waits for its batch counts.

    Args:
        stamps: Of a scan that delivered at least two lines.
    """
    spans = stage_spans(stamps)
    arrived = deliveries(stamps)
    begin, end, lines = int(arrived[0]), int(arrived[-1]), len(arrived) - 1
    edges = np.unique(np.concatenate([edge for span in spans.values() for edge in (span.begin, span.end)]))
    edges = edges[(edges >= begin) & (edges <= end)]
    lengths = np.diff(edges)
    free = np.ones(len(lengths), np.bool_)
    divided: dict[str, Share] = {}
    for stage, span in spans.items():
        busy = np.searchsorted(span.begin, edges[:-1], "right") > np.searchsorted(span.end, edges[:-1], "right")
        alone, hidden = int(lengths[busy & free].sum()), int(lengths[busy & ~free].sum())
        divided[stage] = Share(alone / lines * 1e-9, hidden / lines * 1e-9)
        free &= ~busy
    divided["waiting"] = Share(int(lengths[free].sum()) / lines * 1e-9, 0.0)
    return divided

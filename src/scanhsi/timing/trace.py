"""Traces of scans for trace viewers: ui.perfetto.dev, chrome://tracing.

The Trace Event Format, one lane a stage, so that overlap is seen: one complete event (``ph: X``) a line and stage, and flows that
lead from lane to lane along each line. Events are written as they are made; only the stamps are in memory.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

import numpy as np

from scanhsi.timing.observed import Stamps
from scanhsi.timing.spans import Spans, stage_spans

_LANES = ("move", "exposure", "transfer", "copy", "store")
_FLOW = {"exposure": "s", "transfer": "t", "copy": "t", "store": "f"}
_PID = 1
_ABSENT = np.iinfo(np.int64).min


def write_trace(stamps: Stamps, out: TextIO, *, title: str, missing: Mapping[int, str] | None = None) -> int:
    """Write the trace of a scan.

    Time 0 is the first stamp. Times are in us, exact to the ns.

    Args:
        stamps: Columns of the scan, `scanhsi.cube.records.STAGES`.
        out: Text file to write to.
        title: Name of the scan in the viewer.
        missing: Line -> reason, of lines that were lost; each is a mark on its own lane.

    Returns:
        Number of spans.
    """
    spans = stage_spans(stamps)
    origin = min((int(span.begin.min()) for span in spans.values()), default=0)
    count = 0
    out.write('{"displayTimeUnit":"ms","traceEvents":[\n')
    out.write(",\n".join(json.dumps(event) for event in _names(title)))
    for lane, stage in enumerate(_LANES, 1):
        if stage in spans:
            for event in _events(stage, lane, spans[stage], origin):
                out.write(",\n" + json.dumps(event))
            count += len(spans[stage].line)
    for line, reason in (missing or {}).items():
        out.write(",\n" + json.dumps(_lost(line, reason, stamps, origin)))
    out.write("\n]}\n")
    return count


def _names(title: str) -> Iterator[dict[str, Any]]:
    yield {"ph": "M", "name": "process_name", "pid": _PID, "args": {"name": title}}
    for lane, name in enumerate((*_LANES, "lost"), 1):
        yield {"ph": "M", "name": "thread_name", "pid": _PID, "tid": lane, "args": {"name": name}}
        yield {"ph": "M", "name": "thread_sort_index", "pid": _PID, "tid": lane, "args": {"sort_index": lane}}


def _events(stage: str, lane: int, spans: Spans, origin: int) -> Iterator[dict[str, Any]]:
    columns = (column.tolist() for column in (spans.line, spans.begin, spans.end, spans.waited))
    for line, begin, end, waited in zip(*columns, strict=True):
        where = {"pid": _PID, "tid": lane, "ts": _us(begin - origin)}
        yield {
            **where,
            "ph": "X",
            "name": stage,
            "cat": "scan",
            "dur": _us(end - begin),
            "args": {"line": line, "waited_us": _us(waited)},
        }
        if flow := _FLOW.get(stage):
            yield {**where, "ph": flow, "name": "line", "cat": "line", "id": line, "bp": "e"}


def _lost(line: int, reason: str, stamps: Stamps, origin: int) -> dict[str, Any]:
    """A mark where the lost line was last seen; at the beginning if it never was."""
    seen = max((int(column[line]) for column in stamps.values()), default=_ABSENT)
    return {
        "ph": "i",
        "s": "t",
        "name": f"line {line} lost",
        "cat": "scan",
        "pid": _PID,
        "tid": len(_LANES) + 1,
        "ts": 0 if seen == _ABSENT else _us(seen - origin),
        "args": {"line": line, "reason": reason},
    }


def _us(ns: int) -> float:
    return ns / 1000

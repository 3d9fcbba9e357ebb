"""Traces: valid JSON, one lane a stage, spans as stamped."""

import io
import itertools
import json
from typing import Any

import pytest

from scanhsi.cube.records import NOT_STAMPED, STAGES, LineRecords
from scanhsi.timing.spans import Spans, deliveries, shares, stage_spans
from scanhsi.timing.trace import write_trace

MS = 1_000_000


def records(lines: int = 3, transfer_ms: int = 20) -> LineRecords:
    """A stepped scan: 10 ms exposure, 3 ms move, 1 ms copy; line k+1 is exposed while line k is in transfer."""
    made = LineRecords(lines)
    stamps = made.stamps
    received = 0
    for line in range(lines):
        start = 5 * MS + 13 * MS * line
        if line:
            stamps["commanded"][line], stamps["moved"][line] = start - 3 * MS, start
        stamps["trigger"][line] = stamps["exposure_start"][line] = start
        stamps["exposure_end"][line] = start + 10 * MS
        stamps["first_byte"][line] = start + 10 * MS  # a driver that does not see the link being busy
        received = max(received, start + 10 * MS) + transfer_ms * MS
        stamps["received"][line] = received
        stamps["copied"][line] = stamps["stored"][line] = received + MS
    return made


def events_of(made: LineRecords) -> list[dict[str, Any]]:
    text = io.StringIO()
    write_trace(made.stamps, text, title="SIMULATED scan x", missing=made.missing)
    return json.loads(text.getvalue())["traceEvents"]


def lanes_of(events: list[dict[str, Any]]) -> dict[str, int]:
    return {event["args"]["name"]: event["tid"] for event in events if event["name"] == "thread_name"}


def test_one_named_lane_a_stage() -> None:
    events = events_of(records())
    assert list(lanes_of(events)) == ["move", "exposure", "transfer", "copy", "store", "lost"]
    assert {"name": "SIMULATED scan x"} in [event.get("args") for event in events]


def test_spans_are_the_stamps() -> None:
    made = records()
    events = events_of(made)
    lanes = lanes_of(events)
    spans = {(event["tid"], event["args"]["line"]): event for event in events if event["ph"] == "X"}
    assert len(spans) == 3 * 5 - 1  # the first line is moved to before the scan
    for (lane, line), span in spans.items():
        first, last = {
            lanes["move"]: ("commanded", "moved"),
            lanes["exposure"]: ("exposure_start", "exposure_end"),
            lanes["transfer"]: ("first_byte", "received"),
            lanes["copy"]: ("received", "copied"),
            lanes["store"]: ("copied", "stored"),
        }[lane]
        end_ns = 5 * MS + round((span["ts"] + span["dur"]) * 1000)
        ready_ns = 5 * MS + round((span["ts"] - span["args"]["waited_us"]) * 1000)
        assert end_ns == made.stamps[last][line]
        assert ready_ns == made.stamps[first][line]


def test_spans_of_a_lane_do_not_overlap_though_lines_wait() -> None:
    events = events_of(records(4))
    transfers = [event for event in events if event["ph"] == "X" and event["name"] == "transfer"]
    assert [event["args"]["waited_us"] for event in transfers] == [0, 7000, 14000, 21000]
    for one, other in itertools.pairwise(transfers):
        assert one["ts"] + one["dur"] <= other["ts"]


def test_stages_of_neighbouring_lines_overlap() -> None:
    events = [event for event in events_of(records()) if event["ph"] == "X"]
    at = {(event["name"], event["args"]["line"]): (event["ts"], event["ts"] + event["dur"]) for event in events}
    assert at["transfer", 0][0] < at["exposure", 1][0] < at["transfer", 0][1]


def test_a_lost_line_is_marked_with_its_reason() -> None:
    made = records()
    for stage in STAGES[STAGES.index("received") :]:
        made.stamps[stage][1] = NOT_STAMPED
    made.mark_missing(1, "3 packets missing")
    (lost,) = [event for event in events_of(made) if event["ph"] == "i"]
    assert lost["args"] == {"line": 1, "reason": "3 packets missing"}
    assert lost["ts"] == (made.stamps["first_byte"][1] - 5 * MS) / 1000


def test_a_scan_without_a_line_is_an_empty_trace() -> None:
    assert {event["ph"] for event in events_of(LineRecords(0))} == {"M"}


def test_spans_are_exact_far_from_zero() -> None:
    made = records()
    for column in made.stamps.values():
        column[column > 0] += 987_654_321_987_654_321
    assert [event for event in events_of(made) if event["ph"] == "X"] == [
        event for event in events_of(records()) if event["ph"] == "X"
    ]


def test_shares_add_up_to_the_period_and_hide_what_overlaps() -> None:
    divided = shares(records(40, transfer_ms=12).stamps)
    assert sum(share.alone_s for share in divided.values()) == pytest.approx(0.013)
    assert divided["exposure"].alone_s == pytest.approx(0.010, rel=0.05)
    assert divided["move"].alone_s == pytest.approx(0.003, rel=0.05)
    assert divided["transfer"].hidden_s == pytest.approx(0.012, rel=0.05)


def test_shares_of_a_scan_that_the_link_holds_up_are_those_of_lines_delivered() -> None:
    stamps = records(40).stamps
    assert set((deliveries(stamps)[1:] - deliveries(stamps)[:-1]).tolist()) == {20 * MS}
    divided = shares(stamps)
    assert sum(share.alone_s for share in divided.values()) == pytest.approx(0.020)
    assert divided["transfer"].alone_s + divided["transfer"].hidden_s == pytest.approx(0.020, rel=0.01)


def test_shares_of_a_sequential_scan_hide_nothing() -> None:
    made = LineRecords(5)
    for line in range(5):
        for number, stage in enumerate(("commanded", "moved", "exposure_start", "exposure_end", "received", "copied")):
            made.stamps[stage][line] = (10 * line + number) * MS
        made.stamps["stored"][line] = (10 * line + 7) * MS
    divided = shares(made.stamps)
    assert not any(share.hidden_s for share in divided.values())
    assert divided["store"].alone_s == pytest.approx(0.002)
    assert divided["waiting"].alone_s == pytest.approx(0.004)  # until the next command, and from moved to exposing


def test_stages_never_stamped_are_left_out() -> None:
    made = records()
    made.stamps["commanded"][:] = NOT_STAMPED
    found = stage_spans(made.stamps)
    assert "move" not in found
    assert isinstance(found["copy"], Spans)
    assert found["copy"].busy_ns == 3 * MS

"""What the fuzz has found once: each case, as it printed it, stays right."""

from __future__ import annotations

import pytest

from scanhsi.testing.cases import Case
from scanhsi.testing.fuzz import judge
from scanhsi.testing.runs import warm_up
from support.fuzzing import silence

FOUND = {
    "frames that come at the same moment: the report divided by a period of zero": '{"profile":"ideal","plan":{"mode":'
    '"continuous","lines":2,"step":1,"start":0,"exposure_s":0.01,"pixel_format":"Mono8"},"lines_per_shard":1,"faults":'
    '{"faults":[{"kind":"frame late","nth":0,"for_s":0.7}],"seed":963}}',
    "a pause that was over before the line was: the camera was armed twice": '{"plan":{"mode":"stepped","lines":2,"step":1,'
    '"start":0,"exposure_s":0.002,"pixel_format":"Mono8"},"faults":{"faults":[{"kind":"paused","nth":38,"for_s":0.003}],'
    '"seed":28}}',
    "a frame with the time stamp of the one before: the next one was put one line too far": '{"profile":"ideal","plan":'
    '{"mode":"continuous","lines":8,"step":1,"start":0,"exposure_s":0.01,"pixel_format":"Mono8"},"faults":{"faults":'
    '[{"kind":"metadata stale","nth":5}],"seed":610}}',
    "a motion without duration as an exposure ends: the simulated frame was smeared": '{"profile":"ideal","plan":{"mode":'
    '"stepped","lines":3,"step":7,"start":66,"exposure_s":0.05,"pixel_format":"Mono12Packed"}}',
    "a pause that was over before a look-ahead scan saw it: it went on with the next line, and had not moved": '{"plan":{"mode":'
    '"stepped","lines":8,"step":1,"start":0,"exposure_s":0.002,"pixel_format":"Mono12","look_ahead":0.01},"lines_per_shard":1,'
    '"light":3.0,"faults":{"faults":[{"kind":"paused","nth":181,"for_s":0.0005}],"seed":413}}',
}


@pytest.mark.parametrize("name", FOUND)
def test_found_once(name: str) -> None:
    with silence():
        warm_up()
        verdict = judge(Case.model_validate_json(FOUND[name]))
    assert not verdict.violations

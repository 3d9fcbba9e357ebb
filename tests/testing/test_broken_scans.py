"""A thousand broken scans a day: half of them here, the others in `test_broken_scans_more`, so that two processes share them.

``scanhsi-fuzz --seed S --scans N`` runs any others.
"""

from __future__ import annotations

import json

import pytest

from scanhsi.testing import fuzz
from scanhsi.testing.cases import Case, draw
from scanhsi.testing.checks import Violation
from scanhsi.testing.faults import Fault, FaultPlan, Kind
from scanhsi.testing.runs import run
from support.fuzzing import clean, silence

SEED = fuzz.today()


@pytest.mark.parametrize("first", range(0, 500, 100))
def test_scans_of_the_day(first: int) -> None:
    clean(SEED, range(first, first + 100))


@pytest.mark.soak
def test_ten_thousand_scans(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["--seed", "10", "--scans", "10000"]) == 0, capsys.readouterr().out


def test_a_scan_runs_the_same_way_each_time() -> None:
    """By its number, and from its JSON."""
    with silence():
        for scan in range(8):
            case = draw(3, scan)
            again = Case.model_validate_json(case.text())
            assert again == case
            ends = []
            for one in (case, again):
                with run(one) as outcome:
                    ends.append((outcome.callbacks, outcome.ended_s, repr(outcome.error), repr(outcome.report)))
            assert ends[0] == ends[1]


def test_a_real_hang_is_told_and_the_others_go_on() -> None:
    """A scan that keeps its process from going on; the watchdog ends that."""
    seen = list(fuzz.in_processes("hang", range(3), 1, watchdog_s=2.0, judged=_hangs_at_1))
    assert [(verdict.scan, list(verdict.violations)) for verdict in seen] == [
        (0, []),
        (1, ["it hangs for real"]),
        (2, []),
    ]


def _hangs_at_1(case: Case, scan: int) -> fuzz.Verdict:
    while scan == 1:
        pass
    return fuzz.Verdict(scan, "ok", {})


BROKEN = Case(
    plan={"mode": "stepped", "lines": 12, "step": 2, "start": 40, "exposure_s": 0.02, "on_fault": "skip"},
    codec="lz4",
    faults=FaultPlan(
        faults=(
            Fault(kind=Kind.MOVE_SLOW, nth=3, for_s=0.02),
            Fault(kind=Kind.FRAME_INCOMPLETE, nth=7, lasts=2),
            Fault(kind=Kind.FRAME_TWICE, nth=2),
        )
    ),
)


def test_a_failure_shrinks_to_what_matters() -> None:
    """Whatever loses a line: one fault, of one frame, of a scan of one line."""

    def loses_a_line(case: Case) -> bool:
        with run(case) as outcome:
            return outcome.report is not None and outcome.report.missing > 0

    with silence():
        assert loses_a_line(BROKEN)
        small = fuzz.shrink(BROKEN, loses_a_line)
    assert [fault.kind for fault in small.faults.faults] == [Kind.FRAME_INCOMPLETE]
    assert small.plan["lines"] == 1
    assert small.faults.faults[0].nth == 0
    assert small.faults.faults[0].lasts == 1


def test_the_command(capsys: pytest.CaptureFixture[str], tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    with silence():
        assert fuzz.main(["--seed", "3", "--scan", "1"]) == 0
        assert "scan 1 of seed 3" in capsys.readouterr().out
        file = tmp_path / "case.json"
        file.write_text(BROKEN.text())
        assert fuzz.main(["--replay", str(file)]) == 0
        assert "what happened: frame incomplete" in capsys.readouterr().out
        monkeypatch.setattr(fuzz, "check", lambda outcome: [Violation("nothing is ever right", "so it is")])
        assert fuzz.main(["--seed", "3", "--scan", "1"]) == 1
        told = capsys.readouterr().out
    assert "nothing is ever right: so it is" in told
    text = told.split("--replay ")[1].strip().strip("'")
    assert Case.model_validate(json.loads(text)).plan["lines"] == 1

"""The net holds: each bug that is planted on purpose is found by the fuzz."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from scanhsi.testing.cases import draw
from scanhsi.testing.fuzz import judge
from scanhsi.testing.runs import warm_up
from support.fuzzing import silence
from support.planted import PLANTED, planted

SEED = "p"
QUICK = {
    "moves before the exposure ends": "the mirror moved in an exposure",
    "retakes at the wrong line": "a stored line is not true",
    "forgets to disarm": "it is not safe",
    "forgets to stop": "it is not safe",
    "flush is not awaited": "what was stored is lost",
    "swallows a cancellation": "the wrong exception",
    "reasons are made up": "a reason does not match the fault",
    "lets device errors out": "the wrong exception",
    "no deadlines": "it hangs",
    "credit leak": "it failed needlessly",
}


def scans_until_found(name: str, limit: int) -> tuple[int, set[str]]:
    """How many scans it takes to find a bug, and by what it is noticed."""
    with silence():
        warm_up()
        with planted(name):
            for scan in range(limit):
                if violations := judge(draw(SEED, scan), scan).violations:
                    return scan + 1, set(violations)
    pytest.fail(f"{name}: not found in {limit} scans of seed {SEED}")


@pytest.mark.parametrize("name", QUICK)
def test_found_soon(name: str) -> None:
    _, names = scans_until_found(name, 200)
    assert QUICK[name] in names


@pytest.mark.soak
@pytest.mark.parametrize("name", PLANTED)
def test_found(name: str, record_property: Callable[[str, object], None]) -> None:
    scans, _ = scans_until_found(name, 2000)
    record_property("scans until found", scans)


def test_nothing_is_planted_in_the_end() -> None:
    """Each bug is taken out again: else they would vouch for each other."""
    with silence():
        warm_up()
        for name in PLANTED:
            with planted(name):
                pass
        assert not any(judge(draw(SEED, scan), scan).violations for scan in range(20))

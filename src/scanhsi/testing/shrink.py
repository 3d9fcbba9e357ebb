"""From a scan that breaks an invariant to a small one that breaks it, too."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from scanhsi.testing.cases import Case
from scanhsi.testing.faults import Fault

_MOST_TRIES: Final = 300

Fails = Callable[[Case], bool]


def shrink(case: Case, fails: Fails, tries: int = _MOST_TRIES) -> Case:
    """The smallest case found that still fails: first with as few faults as can be, then with less of everything else.

    Args:
        case: It fails.
        fails: Runs a case, and tells whether it fails in the same way.
        tries: So many are run at most.
    """
    found = True
    while found and tries:
        found = False
        for smaller in _smaller(case):
            if not tries:
                break
            tries -= 1
            if fails(smaller):
                case, found = smaller, True
                break
    return case


def _smaller(case: Case) -> Iterator[Case]:
    """Cases that are a little simpler, the boldest first."""
    faults = case.faults.faults
    pieces = len(faults)
    while pieces > 1:  # delta debugging: without the first half, the second, the first quarter, ...
        size = -(-len(faults) // pieces) if pieces < len(faults) else 1
        pieces = pieces // 2
        for first in range(0, len(faults), max(size, 1)):
            yield _with_faults(case, faults[:first] + faults[first + max(size, 1) :])
    if len(faults) == 1:
        yield _with_faults(case, ())
    lines = case.plan["lines"]
    for fewer in sorted({1, 2, lines // 2, lines - 1} - {0, lines}):
        if fewer < lines:
            yield _with_plan(case, lines=fewer)
    for number, fault in enumerate(faults):
        for simpler in _simpler(fault):
            yield _with_faults(case, (*faults[:number], simpler, *faults[number + 1 :]))
    yield from _plainer(case)


def _simpler(fault: Fault) -> Iterator[Fault]:
    if fault.lasts > 1:
        yield fault.model_copy(update={"lasts": 1})
    if fault.after_s:
        yield fault.model_copy(update={"after_s": 0.0})
    if fault.nth:
        for nth in sorted({0, fault.nth // 2, fault.nth - 1} - {fault.nth}):
            yield fault.model_copy(update={"nth": nth})


def _plainer(case: Case) -> Iterator[Case]:
    defaults = {name: field.default for name, field in Case.model_fields.items() if not field.is_required()}
    for name in (
        "resumes",
        "target",
        "codec",
        "durability",
        "bin_samples",
        "offset",
        "overlap",
        "bands",
        "samples",
        "seed",
    ):
        if getattr(case, name) != defaults[name]:
            yield case.model_copy(update={name: defaults[name]})
    if case.profile != "ideal":
        yield case.model_copy(update={"profile": "ideal"})
    for name, plain in (("start", 0), ("step", 1), ("pixel_format", "Mono8"), ("exposure_s", 0.01)):
        if case.plan.get(name) != plain:
            yield _with_plan(case, **{name: plain})
    for name in sorted(case.plan.keys() - {"mode", "lines", "step", "start", "pixel_format", "exposure_s"}):
        yield case.model_copy(update={"plan": {key: value for key, value in case.plan.items() if key != name}})


def _with_faults(case: Case, faults: tuple[Fault, ...]) -> Case:
    return case.model_copy(update={"faults": case.faults.model_copy(update={"faults": faults})})


def _with_plan(case: Case, **changes: Any) -> Case:
    return case.model_copy(update={"plan": {**case.plan, **changes}})

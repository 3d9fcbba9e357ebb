"""The cancellation fuzzer finds the faults it is for."""

import asyncio
import time
from collections.abc import Callable, Coroutine

import pytest

from scanhsi import clock
from support.fuzz import Outcome, cancel_everywhere, run_with_cancel_before


async def tidy() -> str:
    async with asyncio.TaskGroup() as group:
        for delay_ms in (1, 2, 3):
            group.create_task(asyncio.sleep(delay_ms * 1e-3))
        await clock.run_blocking(1e-3, time.sleep, 1e-4)
    return "done"


def faults(outcome: Outcome) -> list[str]:
    found = [] if outcome.surfaced else ["swallowed"]
    found += ["orphans"] if outcome.orphans else []
    return found + (["unhandled"] if outcome.unhandled else []) + (["error"] if outcome.error else [])


def all_faults(main: Callable[[], Coroutine[None, None, object]]) -> set[str]:
    return {fault for outcome in cancel_everywhere(main) for fault in faults(outcome)}


def test_without_cancellation_it_counts() -> None:
    outcome = run_with_cancel_before(tidy, None)
    assert (outcome.result, outcome.requested, outcome.surfaced) == ("done", 0, False)
    assert outcome.ended_at_ns == 3_000_000
    assert outcome.callbacks > 8
    assert outcome == run_with_cancel_before(tidy, None, inline=True)


@pytest.mark.parametrize("inline", [False, True])
@pytest.mark.parametrize("again_after", [None, 1, 2, 5])
def test_a_tidy_program_has_a_case_a_callback_and_no_fault(again_after: int | None, inline: bool) -> None:
    outcomes = list(cancel_everywhere(tidy, again_after=[again_after], inline=inline))
    assert [faults(outcome) for outcome in outcomes] == [[]] * run_with_cancel_before(tidy, None).callbacks
    assert max(outcome.requested for outcome in outcomes) == (1 if again_after is None else 2)


def test_a_swallowed_cancellation_is_found() -> None:
    async def deaf() -> None:
        try:
            await asyncio.sleep(1)
        except asyncio.CancelledError:
            await asyncio.sleep(1)

    assert all_faults(deaf) == {"swallowed"}


def test_an_orphan_is_found() -> None:
    async def careless() -> None:
        child = asyncio.create_task(asyncio.sleep(10))
        await asyncio.sleep(1)
        child.cancel()
        await asyncio.wait([child])

    assert all_faults(careless) == {"orphans"}


def test_an_exception_that_nobody_gets_is_found() -> None:
    async def failing() -> None:
        raise OSError("lost")

    async def careless() -> None:
        child = asyncio.create_task(failing())
        await asyncio.sleep(1)
        await asyncio.wait([child])

    assert "unhandled" in all_faults(careless)


def test_a_hang_in_cleanup_is_found() -> None:
    async def hanging() -> None:
        try:
            await asyncio.sleep(1)
        except asyncio.CancelledError:
            await asyncio.get_running_loop().create_future()

    async def hanging_child() -> None:
        tasks.append(asyncio.create_task(hanging()))
        await asyncio.sleep(0)

    tasks: list[asyncio.Task[None]] = []
    assert isinstance(run_with_cancel_before(hanging, 1).error, clock.VirtualDeadlock)
    outcome = run_with_cancel_before(hanging_child, None)
    assert len(outcome.orphans) == 1
    assert any("VirtualDeadlock" in message for message in outcome.unhandled)


def test_cleanup_that_a_second_cancellation_breaks_is_found() -> None:
    parked: list[bool] = []

    async def fragile() -> None:
        parked.append(False)
        try:
            await asyncio.sleep(1)
        finally:
            await asyncio.sleep(1)
            parked[-1] = True

    def never_parked(distance: int | None) -> int:
        parked.clear()
        for _ in cancel_everywhere(fragile, again_after=[distance]):
            pass
        return parked.count(False)

    assert never_parked(None) == 1  # the cancellation that comes when cleanup runs already
    assert never_parked(1) > 1

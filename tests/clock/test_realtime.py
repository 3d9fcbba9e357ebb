"""Real-time options: applied, told, undone; a refusal is told and is no error."""

import asyncio
import gc
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from scanhsi import clock
from scanhsi.clock import Granted, RealTime, real_time

linux = pytest.mark.skipif(sys.platform != "linux", reason="SCHED_FIFO of a thread is Linux's")


@pytest.fixture(autouse=True)
def nothing_frozen() -> Iterator[None]:
    gc.unfreeze()  # see conftest.py
    yield
    gc.freeze()


async def _state() -> tuple[int, float]:
    return gc.get_freeze_count(), sys.getswitchinterval()


def test_nothing_is_changed_unasked() -> None:
    async def main() -> Granted:
        before = await _state()
        with real_time(RealTime()) as told:
            assert await _state() == before
        return told

    assert clock.run(main()) == Granted("precise", ())
    assert clock.run(main(), virtual=True).loop == "virtual"
    assert "EventLoop" in asyncio.run(main()).loop


def test_gc_and_switch_are_applied_and_undone() -> None:
    async def main() -> Granted:
        before = await _state()
        with real_time(RealTime.of("gc, switch")) as told:
            frozen, interval_s = await _state()
            assert frozen > before[0]
            assert interval_s == pytest.approx(0.0005)
        assert await _state() == before
        return told

    told = clock.run(main())
    assert told.asked == ("gc", "switch") == tuple(told.granted)
    assert not told.refused


def test_options_are_undone_after_an_error() -> None:
    async def main() -> None:
        before = await _state()
        with pytest.raises(ZeroDivisionError), real_time(RealTime.of("gc,switch")):
            raise ZeroDivisionError
        assert await _state() == before

    clock.run(main())


@linux
def test_fifo_is_for_the_thread_of_the_loop_alone() -> None:
    async def main() -> Granted:
        assert sys.platform == "linux"
        before, others = os.sched_getscheduler(0), list[int]()
        with real_time(RealTime(fifo=1)) as told:
            if told.granted:
                assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
                thread = threading.Thread(target=lambda: others.append(os.sched_getscheduler(0)))
                thread.start()
                thread.join()
                assert others == [os.SCHED_OTHER]
        assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == before & ~os.SCHED_RESET_ON_FORK
        return told

    told = clock.run(main())
    assert set(told.granted) | set(told.refused) == {"fifo"}


@linux
def test_a_refusal_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_words: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    async def main() -> Granted:
        with real_time(RealTime.of("all")) as told:
            return told

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    told = clock.run(main())
    assert tuple(told.granted) == ("gc", "switch")
    assert "CAP_SYS_NICE" in told.refused["fifo"]
    assert "fifo REFUSED" in str(told)


@pytest.mark.parametrize("words", ["fast", "gc,", ""])
def test_unknown_words_are_refused(words: str) -> None:
    with pytest.raises(ValueError, match="there are gc, fifo, switch, or all"):
        RealTime.of(words)


@pytest.mark.parametrize("wrong", [{"fifo": 100}, {"fifo": -1}, {"switch_interval_s": -1.0}])
def test_impossible_values_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="not"):
        RealTime(**wrong)

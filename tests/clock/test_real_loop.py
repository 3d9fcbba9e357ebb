"""The real loop: same functions, real time, timers that are neither early nor rounded to ms."""

import asyncio
import os
import resource
import selectors
import statistics
import sys
import threading
import time

import pytest

from scanhsi import clock
from scanhsi.clock import RealTimeLoop


def test_the_one_flag_selects_the_loop() -> None:
    async def main() -> tuple[bool, type[asyncio.AbstractEventLoop]]:
        return clock.is_virtual(), type(asyncio.get_running_loop())

    assert clock.run(main(), hold_timeout=1.0) == (False, RealTimeLoop)
    assert clock.run(main(), virtual=True, hold_timeout=1.0) == (True, clock.VirtualTimeLoop)


def test_time_is_that_of_the_monotonic_clock_in_either_unit() -> None:
    async def main() -> list[int]:
        loop = asyncio.get_running_loop()
        return [time.monotonic_ns(), clock.now_ns(), round(loop.time() * 1e9), time.monotonic_ns()]

    stamps = clock.run(main())
    assert stamps == sorted(stamps)


def test_the_functions_work_on_any_loop() -> None:
    async def main() -> int:
        assert not clock.is_virtual()
        with clock.hold():
            assert await clock.run_blocking(1e6, threading.get_ident) != threading.get_ident()
        start_ns = clock.now_ns()
        await clock.sleep_until_ns(start_ns + 2_000_000)
        return clock.now_ns() - start_ns

    assert clock.run(main()) >= 2_000_000
    assert asyncio.run(main()) >= 2_000_000


def test_sleep_until_sleeps_again_when_a_loop_wakes_it_early() -> None:
    """uvloop fires timers up to 0.5 ms early."""

    class Early(RealTimeLoop):
        def call_at(self, when, callback, *args, context=None):
            return super().call_at(when - 0.5e-3, callback, *args, context=context)

    async def main() -> list[int]:
        late_ns: list[int] = []
        for _ in range(20):
            when_ns = clock.now_ns() + 1_000_000
            await clock.sleep_until_ns(when_ns)
            late_ns.append(clock.now_ns() - when_ns)
        return late_ns

    with asyncio.Runner(loop_factory=Early) as runner:
        assert min(runner.run(main())) >= 0


@pytest.mark.skipif(sys.platform != "linux", reason="epoll is Linux's")
def test_timers_are_not_rounded_up_to_ms() -> None:
    """Timers of 0.2 ms: with epoll's rounding none could end before 1 ms."""

    async def naps_s() -> list[float]:
        naps: list[float] = []
        for _ in range(100):
            start = time.perf_counter()
            await asyncio.sleep(0.2e-3)
            naps.append(time.perf_counter() - start)
        return naps

    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.EpollSelector())) as runner:
        # the median: a nap whose timer fell due before epoll was asked, on a busy computer, is not rounded
        assert statistics.median(runner.run(naps_s())) > 0.9e-3, "the comparison: stock epoll"
    assert 0.2e-3 <= min(clock.run(naps_s())) < 0.9e-3


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of select elsewhere")
@pytest.mark.parametrize("loop_is_high", [False, True])
def test_descriptors_above_1023_work(loop_is_high: bool) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 1200:
        pytest.skip("the hard limit of open files is too low")
    opened: list[int] = []

    def fill() -> None:
        while not opened or opened[-1] < 1030:
            opened.append(os.open(os.devnull, os.O_RDONLY))

    async def main() -> bytes:
        if not loop_is_high:
            fill()
        read_end, write_end = os.pipe()
        assert read_end > 1023
        opened.extend((read_end, write_end))
        arrived = asyncio.Event()
        loop = asyncio.get_running_loop()
        loop.add_reader(read_end, arrived.set)
        loop.call_later(2e-3, os.write, write_end, b"!")
        async with asyncio.timeout(30):
            await arrived.wait()
        loop.remove_reader(read_end)
        return os.read(read_end, 1)

    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 1200), hard))
    try:
        if loop_is_high:
            fill()
        assert clock.run(main()) == b"!"
    finally:
        for descriptor in opened:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_sockets_and_threads_wake_a_sleeping_loop() -> None:
    async def main() -> None:
        loop, woken = asyncio.get_running_loop(), asyncio.Event()
        threading.Timer(0.02, loop.call_soon_threadsafe, [woken.set]).start()
        async with asyncio.timeout(30):
            await woken.wait()

    clock.run(main())

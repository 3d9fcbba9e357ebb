"""The virtual loop piece by piece: its clock, its jobs, its watchdog and its limits."""

import asyncio
import gc
import math
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from scanhsi import clock
from scanhsi.clock import HoldTimeout, VirtualDeadlock, VirtualTimeLoop

MS = 1_000_000


def fail_with(error: BaseException) -> None:
    raise error


def virtual_loop() -> VirtualTimeLoop:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualTimeLoop)
    return loop


# The clock


def test_it_has_the_private_names_of_asyncio_that_it_relies_on() -> None:
    loop = asyncio.SelectorEventLoop()
    loop.close()
    declared = [name for name in VirtualTimeLoop.__annotations__ if name.startswith("_")]
    functions = ["_check_closed", "_check_default_executor", "_write_to_self", "_read_from_self"]
    assert declared
    assert [name for name in declared + functions if not hasattr(loop, name)] == []


def test_time_is_an_integer_of_ns_from_a_given_start() -> None:
    async def main() -> list[float]:
        loop = virtual_loop()
        stamps = [loop.time_ns(), loop.time()]
        await asyncio.sleep(0.2)
        return [*stamps, loop.time_ns(), loop.time()]

    assert clock.run_virtual(main(), start=0.1) == [100 * MS, 0.1, 300 * MS, 0.3]


@pytest.mark.parametrize("start", [1e7, 1.7e9, -1e-9, math.nan, math.inf])
def test_a_start_outside_the_range_of_the_clock_is_refused(start: float) -> None:
    with pytest.raises(ValueError, match="virtual time cannot start at"):
        VirtualTimeLoop(start=start)
    gc.collect()  # the half-made loop must not warn


def test_it_still_ticks_at_the_end_of_its_range() -> None:
    async def main() -> int:
        for _ in range(100):
            await asyncio.sleep(1e-3)
        await clock.sleep_until_ns(clock.now_ns() + 1)
        return clock.now_ns()

    late = clock.run_virtual(main(), start=9_999_998.9)
    assert 0 <= late - 9_999_999_000_000_000 <= 200  # floats are 1.9 ns apart here


def test_a_time_that_floats_cannot_hold_to_the_ns_does_not_stop_the_clock() -> None:
    """This ns as s and back is 1 ns less: a time before its own timer, at which asyncio would never run it."""
    when_ns = 4290002_735993259
    assert round(when_ns / 1e9 * 1e9) < when_ns

    async def main() -> int:
        await clock.sleep_until_ns(when_ns)
        return clock.now_ns()

    assert clock.run_virtual(main(), start=4290000.0) - when_ns in (0, 1)


@pytest.mark.parametrize("delay", [1e7, 1e9, math.inf])
def test_a_sleep_beyond_the_range_is_for_ever(delay: float) -> None:
    with pytest.raises(VirtualDeadlock):
        clock.run_virtual(asyncio.sleep(delay))


def test_timers_one_ns_apart_are_kept_apart() -> None:
    async def main(instants: list[int]) -> list[int]:
        loop, log = virtual_loop(), []
        for ns in instants:
            loop.call_at(ns / 1e9, lambda: log.append(loop.time_ns()))
        await asyncio.sleep(6)
        return log

    instants = [*range(2000), *range(5_000_000_000, 5_000_002_000)]
    assert clock.run_virtual(main(instants[::-1])) == instants


def test_times_equal_but_for_rounding_are_one_instant() -> None:
    async def main() -> list[int]:
        loop, log = virtual_loop(), []
        loop.call_at(0.1 + 0.2, lambda: log.append(loop.time_ns()))
        loop.call_at(0.3, lambda: log.append(loop.time_ns()))
        await asyncio.sleep(1)
        return log

    assert clock.run_virtual(main()) == [300 * MS, 300 * MS]


def test_the_least_delay_is_one_ns_and_a_negative_one_none() -> None:
    async def main() -> list[int]:
        await asyncio.sleep(-1)
        stamps = [clock.now_ns()]
        await asyncio.sleep(1e-12)
        return [*stamps, clock.now_ns()]

    assert clock.run_virtual(main()) == [0, 1]


def test_sleep_until_ends_at_the_instant_and_yields_when_that_is_past() -> None:
    async def main() -> list[int]:
        stamps: list[int] = []
        for when_ns in (1, 1_000_000_007, 5):
            await clock.sleep_until_ns(when_ns)
            stamps.append(clock.now_ns())
        other = asyncio.create_task(asyncio.sleep(0))
        await clock.sleep_until_ns(0)
        await clock.sleep_until_ns(0)
        assert other.done()
        return stamps

    assert clock.run_virtual(main()) == [1, 1_000_000_007, 1_000_000_007]


# Jobs


def test_modelled_costs_overlap_real_work_and_are_exact() -> None:
    """Six jobs that meet at a barrier: they end only if all run at once, whatever their modelled cost."""
    barrier = threading.Barrier(6)

    async def main() -> list[int]:
        async def job(cost_s: float) -> int:
            await clock.run_blocking(cost_s, barrier.wait, 30)
            return clock.now_ns()

        virtual_loop().set_default_executor(ThreadPoolExecutor(6))
        costs = [50e-3, 51e-3, 52e-3, 52e-3, 51e-3, 50e-3]
        return list(await asyncio.gather(*map(job, costs)))

    assert clock.run_virtual(main()) == [50 * MS, 51 * MS, 52 * MS, 52 * MS, 51 * MS, 50 * MS]


@pytest.mark.parametrize("inline", [False, True])
def test_a_job_longer_than_its_cost_still_costs_that(inline: bool) -> None:
    async def main() -> tuple[str, int]:
        ticker = asyncio.create_task(asyncio.sleep(4e-3))
        answer = await clock.run_blocking(5e-3, lambda: time.sleep(0.03) or "late")
        assert ticker.done()
        return answer, clock.now_ns()

    assert clock.run_virtual(main(), inline=inline) == ("late", 5 * MS)


@pytest.mark.parametrize("inline", [False, True])
@pytest.mark.parametrize("submit", [lambda f: clock.run_blocking(1e-3, f), asyncio.to_thread])
def test_an_error_in_a_job_is_its_result(inline: bool, submit: Callable[[object], Awaitable[None]]) -> None:
    async def main() -> None:
        await submit(lambda: fail_with(OSError("disk full")))

    with pytest.raises(OSError, match="disk full"):
        clock.run_virtual(main(), inline=inline)


def test_inline_jobs_run_in_the_thread_of_the_loop_and_let_keyboard_interrupt_through() -> None:
    async def main() -> int:
        ident = await asyncio.to_thread(threading.get_ident)
        with pytest.raises(KeyboardInterrupt):
            asyncio.get_running_loop().run_in_executor(None, fail_with, KeyboardInterrupt())
        return ident

    assert clock.run_virtual(main(), inline=True) == threading.get_ident()


@pytest.mark.parametrize("inline", [False, True])
def test_results_arrive_in_order_of_submission_one_at_a_time(inline: bool) -> None:
    async def main() -> list[str]:
        log: list[str] = []
        slow_may_end = threading.Event()

        async def job(name: str, fn: Callable[[], object]) -> None:
            await asyncio.to_thread(fn)
            log.append(name)
            await asyncio.sleep(0)
            log.append(name + "!")

        slow: Callable[[], object] = (lambda: None) if inline else (lambda: slow_may_end.wait(30))
        async with asyncio.TaskGroup() as group:
            group.create_task(job("slow", slow))
            group.create_task(job("quick", slow_may_end.set))
        return log

    assert clock.run_virtual(main(), inline=inline) == ["slow", "slow!", "quick", "quick!"]


@pytest.mark.parametrize("inline", [False, True])
def test_a_due_timer_goes_before_a_job_that_is_done(inline: bool) -> None:
    async def main() -> list[str]:
        log: list[str] = []
        loop = virtual_loop()
        job = loop.run_in_executor(None, log.append, "ran")
        while not log:
            time.sleep(1e-3)  # so that it is done before the loop looks
        job.add_done_callback(lambda _: log.append("job"))
        loop.call_later(0, log.append, "timer")
        await job
        return log

    assert clock.run_virtual(main(), inline=inline) == ["ran", "timer", "job"]


def test_the_clock_waits_for_a_job_whose_future_was_cancelled() -> None:
    async def main() -> tuple[bool, int]:
        ended = threading.Event()
        task = asyncio.create_task(asyncio.to_thread(lambda: time.sleep(0.03) or ended.set()))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        at = clock.now_ns()
        await asyncio.sleep(1e-3)
        return ended.is_set(), at

    assert clock.run_virtual(main()) == (True, 0)


@pytest.mark.parametrize("cost_s", [-1e-9, math.nan, math.inf])
@pytest.mark.parametrize("virtual", [False, True])
def test_a_cost_that_is_no_duration_is_refused_in_both_times(cost_s: float, virtual: bool) -> None:
    async def main() -> None:
        await clock.run_blocking(cost_s, list)

    with pytest.raises(ValueError, match="cost must be"):
        clock.run(main(), virtual=virtual)


def test_a_subprocess_runs_under_hold() -> None:
    async def main() -> tuple[bytes, int]:
        with clock.hold():
            process = await asyncio.create_subprocess_exec("echo", "hello", stdout=asyncio.subprocess.PIPE)
            output, _ = await process.communicate()
        return output, clock.now_ns()

    assert clock.run_virtual(main()) == (b"hello\n", 0)


# Ends


def test_the_default_executor_is_shut_down_after_jobs_that_nobody_awaits() -> None:
    ended = threading.Event()
    threads = set(threading.enumerate())

    async def main() -> None:
        asyncio.get_running_loop().run_in_executor(None, lambda: time.sleep(0.05) or ended.set())

    clock.run_virtual(main())
    assert ended.is_set()
    for thread in set(threading.enumerate()) - threads:  # the one that joined the others may need a moment
        thread.join(10)
    assert set(threading.enumerate()) <= threads


@pytest.mark.parametrize("how", ["executor", "blocking", "hold"])
def test_a_hang_is_reported_after_real_time_and_cleanup_runs(how: str) -> None:
    released = threading.Event()
    cleaned: list[int] = []

    async def main() -> None:
        try:
            async with asyncio.timeout(3600):
                if how == "executor":
                    await asyncio.to_thread(released.wait, 30)
                elif how == "blocking":
                    await clock.run_blocking(1.0, released.wait, 30)
                else:
                    with clock.hold():
                        await asyncio.get_running_loop().create_future()
        finally:
            await asyncio.sleep(2)
            cleaned.append(clock.now_ns())

    try:
        with pytest.raises(HoldTimeout, match="hold" if how == "hold" else r"job .*Event\.wait"):
            clock.run_virtual(main(), hold_timeout=0.1)
    finally:
        released.set()
    assert cleaned == [3_000_000_000 if how == "blocking" else 2_000_000_000]


def test_the_watchdog_times_each_job_on_its_own() -> None:
    async def main() -> int:
        for _ in range(6):
            await asyncio.to_thread(time.sleep, 0.1)
        return clock.now_ns()

    assert clock.run_virtual(main(), hold_timeout=0.4) == 0


def test_peers_outside_are_waited_for_only_if_told() -> None:
    async def main() -> str:
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[str] = loop.create_future()

        def later() -> None:
            time.sleep(0.05)
            loop.call_soon_threadsafe(answer.set_result, "from outside")

        thread = threading.Thread(target=later)
        thread.start()
        try:
            return await answer
        finally:
            thread.join()

    assert clock.run_virtual(main(), external_io=True) == "from outside"
    with pytest.raises(VirtualDeadlock):
        clock.run_virtual(main())


def test_a_grace_for_sockets_comes_before_a_jump() -> None:
    async def main() -> tuple[bytes, int]:
        ours, theirs = socket.socketpair()
        reader, writer = await asyncio.open_connection(sock=ours)

        def peer() -> None:
            time.sleep(0.02)
            theirs.sendall(b"pong")

        thread = threading.Thread(target=peer)
        thread.start()
        async with asyncio.timeout(1e-3):
            answer = await reader.readexactly(4)
        thread.join()
        theirs.close()
        writer.close()
        await writer.wait_closed()
        return answer, clock.now_ns()

    assert clock.run_virtual(main(), external_io=True, io_grace=30.0) == (b"pong", 0)


def test_sockets_are_seen_while_callbacks_spin_only_with_external_io() -> None:
    async def main() -> bool:
        ours, theirs = socket.socketpair()
        loop, seen = virtual_loop(), asyncio.Event()
        loop.add_reader(ours, seen.set)
        theirs.sendall(b"!")
        for _ in range(1000):
            await asyncio.sleep(0)
        loop.remove_reader(ours)
        ours.close()
        theirs.close()
        return seen.is_set()

    assert clock.run_virtual(main(), external_io=True)
    assert not clock.run_virtual(main())


def test_it_runs_in_debug_mode_and_again_after_stop() -> None:
    async def main() -> int:
        await asyncio.sleep(1)
        await asyncio.to_thread(time.sleep, 1e-3)
        return clock.now_ns()

    assert clock.run_virtual(main(), debug=True) == 1_000_000_000
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert [runner.run(main()), runner.run(main())] == [1_000_000_000, 2_000_000_000]


def test_eager_tasks_work() -> None:
    factory = getattr(asyncio, "eager_task_factory", None)
    if factory is None:
        pytest.skip("eager tasks came with Python 3.12")

    async def main() -> int:
        asyncio.get_running_loop().set_task_factory(factory)
        await asyncio.gather(asyncio.sleep(1), asyncio.to_thread(time.sleep, 1e-3), asyncio.sleep(2))
        return clock.now_ns()

    assert clock.run_virtual(main()) == 2_000_000_000


def test_a_thread_that_lets_go_between_two_looks_is_not_missed() -> None:
    """The callback comes just after the loop saw no event, and the hold is gone just before the loop looks for one."""

    async def main() -> list[int]:
        loop, log = virtual_loop(), []
        held, poll = loop.hold(), loop._hooked.poll
        held.__enter__()

        def poll_and_be_overtaken(timeout: float | None):
            loop._hooked.poll = poll
            events = poll(timeout)
            loop.call_soon_threadsafe(lambda: log.append(loop.time_ns()))
            held.__exit__(None, None, None)
            return events

        loop._hooked.poll = poll_and_be_overtaken
        await asyncio.sleep(1000)
        return log

    assert clock.run_virtual(main()) == [0]

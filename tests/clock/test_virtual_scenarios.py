"""What a virtual-time loop must get right to stand in for real time: whole programs, with real threads, files and sockets."""

import asyncio
import random
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import zarr

from scanhsi import clock

MS = 1_000_000


@pytest.fixture(params=[False, True], ids=["threads", "inline"])
def inline(request: pytest.FixtureRequest) -> bool:
    return request.param


def test_three_stage_scan_takes_the_time_of_its_pipeline() -> None:
    async def stage(n: int, source: asyncio.Queue[int], cost_s: float, sink: asyncio.Queue[int] | None) -> None:
        for _ in range(n):
            line = await source.get()
            await asyncio.sleep(cost_s)
            if sink is not None:
                sink.put_nowait(line)

    async def scan(n: int) -> int:
        exposed: asyncio.Queue[int] = asyncio.Queue()
        received: asyncio.Queue[int] = asyncio.Queue()
        async with asyncio.TaskGroup() as group:
            group.create_task(stage(n, exposed, 18.16e-3, received))
            group.create_task(stage(n, received, 2.5e-3, None))
            for line in range(n):
                await asyncio.sleep(100e-3)
                exposed.put_nowait(line)
                if line < n - 1:
                    await asyncio.sleep(12.1e-3)
        return clock.now_ns()

    assert clock.run_virtual(scan(1200)) == 134_528_560_000


def test_a_real_job_takes_no_virtual_time_though_ticks_wait(inline: bool) -> None:
    async def main() -> tuple[int, int]:
        ticks = 0

        async def tick() -> None:
            nonlocal ticks
            while True:
                await asyncio.sleep(1e-3)
                ticks += 1

        ticker = asyncio.create_task(tick())
        await asyncio.to_thread(time.sleep, 0.05)
        ticker.cancel()
        return clock.now_ns(), ticks

    assert clock.run_virtual(main(), inline=inline) == (0, 0)


def test_a_real_job_cannot_meet_a_virtual_timeout(inline: bool) -> None:
    async def main() -> str:
        async with asyncio.timeout(10e-3):
            await asyncio.to_thread(time.sleep, 0.05)
        return "done"

    assert clock.run_virtual(main(), inline=inline) == "done"


def test_racing_threads_give_the_same_log_each_time() -> None:
    def job() -> None:
        time.sleep(random.random() * 4e-3)

    async def main() -> list[tuple[int, int, int]]:
        log: list[tuple[int, int, int]] = []

        async def worker(number: int) -> None:
            for turn in range(4):
                await asyncio.to_thread(job)
                log.append((clock.now_ns(), number, turn))
                await asyncio.sleep((number + turn) % 3 * 1e-3)

        async with asyncio.TaskGroup() as group:
            for number in range(4):
                group.create_task(worker(number))
        return log

    logs = [clock.run_virtual(main()) for _ in range(6)] + [clock.run_virtual(main(), inline=True)]
    assert len(logs[0]) == 16
    assert all(log == logs[0] for log in logs)


def test_a_bare_thread_under_hold_takes_no_time() -> None:
    async def main() -> int:
        loop = asyncio.get_running_loop()
        loop.call_later(1000.0, lambda: None)
        answer: asyncio.Future[str] = loop.create_future()

        def worker() -> None:
            time.sleep(0.02)
            loop.call_soon_threadsafe(answer.set_result, "hello")

        with clock.hold():
            thread = threading.Thread(target=worker)
            thread.start()
            assert await answer == "hello"
        thread.join()
        return clock.now_ns()

    assert clock.run_virtual(main()) == 0


def test_a_hold_can_be_let_go_by_the_thread_it_is_for() -> None:
    async def main() -> list[int]:
        loop = asyncio.get_running_loop()
        log: list[int] = []
        held = clock.hold()
        held.__enter__()

        def worker() -> None:
            time.sleep(0.02)
            loop.call_soon_threadsafe(lambda: log.append(clock.now_ns()))
            held.__exit__(None, None, None)

        thread = threading.Thread(target=worker)
        thread.start()
        await asyncio.sleep(1000.0)
        thread.join()
        return [*log, clock.now_ns()]

    for _ in range(20):
        assert clock.run_virtual(main()) == [0, 1000_000_000_000]


def test_file_writes_in_threads_cost_only_the_sleeps(tmp_path: Path, inline: bool) -> None:
    data = bytes(range(256)) * 8192

    async def main() -> int:
        for number in range(4):
            await asyncio.to_thread((tmp_path / str(number)).write_bytes, data)
            await asyncio.sleep(10e-3)
        return clock.now_ns()

    assert clock.run_virtual(main(), inline=inline) == 40 * MS
    assert all((tmp_path / str(number)).read_bytes() == data for number in range(4))


def test_zarr_writes_in_threads_cost_only_the_sleeps(tmp_path: Path, inline: bool) -> None:
    """zarr has an event loop of its own, in a thread of its own: neither may notice the virtual one."""
    array = zarr.create_array(tmp_path / "cube.zarr", shape=(4, 64, 32), chunks=(1, 64, 32), dtype="uint16")
    lines = np.arange(4 * 64 * 32, dtype=np.uint16).reshape(4, 64, 32)

    def write(number: int) -> None:
        array[number] = lines[number]

    async def main() -> int:
        for number in range(4):
            await asyncio.to_thread(write, number)
            await asyncio.sleep(10e-3)
        return clock.now_ns()

    assert clock.run_virtual(main(), inline=inline) == 40 * MS
    np.testing.assert_array_equal(zarr.open_array(tmp_path / "cube.zarr", mode="r")[:], lines)


@pytest.mark.parametrize("options", [{}, {"external_io": True, "io_grace": 0.2}], ids=["plain", "external"])
def test_tcp_round_trips_within_the_loop_take_no_time(options: clock.VirtualOptions) -> None:
    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            writer.write(line)
        writer.close()
        hung_up.set()

    hung_up = asyncio.Event()

    async def main() -> int:
        server = await asyncio.start_server(echo, "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        async with asyncio.timeout(0.5):
            for number in range(20):
                writer.write(b"%d\n" % number)
                assert await reader.readline() == b"%d\n" % number
        writer.close()
        await writer.wait_closed()
        await hung_up.wait()
        server.close()
        return clock.now_ns()

    assert clock.run_virtual(main(), **options) == 0


def test_anyio_thread_under_hold_takes_no_time() -> None:
    anyio = pytest.importorskip("anyio")

    async def main() -> int:
        with clock.hold():
            await anyio.to_thread.run_sync(time.sleep, 0.02)
        return clock.now_ns()

    assert clock.run_virtual(main()) == 0


def test_anyio_streams_groups_and_deadlines_are_exact() -> None:
    anyio = pytest.importorskip("anyio")

    async def main() -> list[int]:
        send, receive = anyio.create_memory_object_stream(0)
        got: list[int] = []

        async def produce() -> None:
            async with send:
                for number in range(3):
                    await anyio.sleep(1)
                    await send.send(number)

        async with anyio.create_task_group() as group, receive:
            group.start_soon(produce)
            got.extend([number async for number in receive])
        with anyio.move_on_after(5) as scope:
            await anyio.sleep_forever()
        assert scope.cancelled_caught
        return [*got, clock.now_ns()]

    assert clock.run_virtual(main()) == [0, 1, 2, 8_000_000_000]


def test_anyio_deadline_off_the_grid_ends() -> None:
    """0.1 + 0.2 is no multiple of 1 ns: anyio asks again when woken at 0.3, which comes before its deadline."""
    anyio = pytest.importorskip("anyio")

    async def main() -> int:
        await asyncio.sleep(0.1)
        with anyio.move_on_after(0.2):
            await anyio.sleep_forever()
        return clock.now_ns()

    assert clock.run_virtual(main()) in (300_000_000, 300_000_001)


def test_a_timeout_around_a_longer_sleep_is_exact() -> None:
    async def main() -> int:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(2.5):
                await asyncio.sleep(10)
        return clock.now_ns()

    assert clock.run_virtual(main()) == 2_500_000_000


def test_a_future_that_nobody_sets_is_a_deadlock_and_says_where() -> None:
    cleaned = False

    async def wait_for_godot() -> None:
        nonlocal cleaned
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            await asyncio.sleep(1)  # cleanup runs, in virtual time
            cleaned = True

    with pytest.raises(clock.VirtualDeadlock, match=r"wait_for_godot \(.*test_virtual_scenarios.py"):
        clock.run_virtual(wait_for_godot())
    assert cleaned


def test_sleeps_of_a_few_ns_add_up() -> None:
    async def main() -> int:
        for _ in range(100):
            await asyncio.sleep(30e-9)
        return clock.now_ns()

    assert clock.run_virtual(main()) == 3000

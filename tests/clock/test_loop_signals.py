"""Ctrl-C and signal handlers, on both loops, whatever the loop is doing."""

import asyncio
import os
import signal
import threading
import time
from collections.abc import Awaitable, Callable

import pytest

from scanhsi import clock


async def tick() -> None:
    while True:
        await asyncio.sleep(1e-3)


async def spin() -> None:
    while True:
        await asyncio.sleep(0)


async def held_on_a_job() -> None:
    await asyncio.to_thread(time.sleep, 0.5)
    await asyncio.Event().wait()


async def held() -> None:
    with clock.hold():
        await asyncio.Event().wait()


WAYS = [tick, spin, held_on_a_job, held]


def send_soon(number: signal.Signals) -> threading.Thread:
    def send() -> None:
        time.sleep(0.05)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=send)
    thread.start()
    return thread


@pytest.mark.parametrize("virtual", [True, False], ids=["virtual", "real"])
@pytest.mark.parametrize("way", WAYS)
def test_ctrl_c_cancels_and_cleanup_runs(way: Callable[[], Awaitable[None]], virtual: bool) -> None:
    cleaned = False

    async def main() -> None:
        nonlocal cleaned
        send_soon(signal.SIGINT)
        try:
            await way()
        except asyncio.CancelledError:
            await asyncio.sleep(1e-3)
            cleaned = True
            raise

    with pytest.raises(KeyboardInterrupt):
        clock.run(main(), virtual=virtual)
    assert cleaned


@pytest.mark.parametrize("virtual", [True, False], ids=["virtual", "real"])
@pytest.mark.parametrize("way", WAYS)
def test_a_signal_handler_is_called(way: Callable[[], Awaitable[None]], virtual: bool) -> None:
    async def main() -> str:
        loop, drain = asyncio.get_running_loop(), asyncio.Event()
        loop.add_signal_handler(signal.SIGUSR1, drain.set)
        task = asyncio.ensure_future(way())
        send_soon(signal.SIGUSR1)
        await drain.wait()
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()
        return "drained"

    assert clock.run(main(), virtual=virtual) == "drained"

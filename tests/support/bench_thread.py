"""A stepper bench in a thread with a loop of its own, for tests that run one loop for each use of the device."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Generator
from contextlib import contextmanager

from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings


@contextmanager
def bench_in_thread(settings: StepperTwinSettings) -> Generator[StepperTwin]:
    """A running bench."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    twin = StepperTwin(settings)

    async def enter() -> None:
        await twin.__aenter__()

    async def leave() -> None:
        await twin.__aexit__(None, None, None)

    try:
        asyncio.run_coroutine_threadsafe(enter(), loop).result(60)
        yield twin
        asyncio.run_coroutine_threadsafe(leave(), loop).result(30)
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()

"""Ctrl-C in two stages: the first finishes the line and closes, the second cancels."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager


class Interrupt:
    """Turns signals into a polite stop while lines are being taken, else into a cancellation of the main task.

    Attributes:
        stop: Set by the first Ctrl-C during a scan.
        scanning: Whether there is a line to finish.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.stop = asyncio.Event()
        self.scanning = False
        self._tell = tell
        self._task = asyncio.current_task()

    def interrupted(self) -> None:
        """SIGINT."""
        if self.scanning and not self.stop.is_set():
            self._tell("finishing the line and closing; Ctrl-C again to cancel it.")
            self.stop.set()
        else:
            self.terminated()

    def terminated(self) -> None:
        """SIGTERM, or SIGINT again."""
        self._tell("cancelling: stopping the mirror, closing cube and devices.")
        if self._task is not None:
            self._task.cancel()


@contextmanager
def interrupts(tell: Callable[[str], None]) -> Generator[Interrupt]:
    """Handle SIGINT and SIGTERM in the running loop while entered. Main thread only."""
    loop = asyncio.get_running_loop()
    interrupt = Interrupt(tell)
    loop.add_signal_handler(signal.SIGINT, interrupt.interrupted)
    loop.add_signal_handler(signal.SIGTERM, interrupt.terminated)
    try:
        yield interrupt
    finally:
        loop.remove_signal_handler(signal.SIGINT)
        loop.remove_signal_handler(signal.SIGTERM)

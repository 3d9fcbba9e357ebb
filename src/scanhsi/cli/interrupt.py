"""Signals to a scan: Ctrl-C in two stages, the first finishes the line and closes, the second cancels; Ctrl-Z pauses or goes on."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager

from scanhsi.engine.steering import ScanControl


class Interrupt:
    """Turns signals into a polite stop while lines are being taken, else into a cancellation of the main task.

    Attributes:
        control: Of the scan: stopped by the first Ctrl-C, paused by the first Ctrl-Z.
        scanning: Whether there is a line to finish.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.control = ScanControl()
        self.scanning = False
        self._tell = tell
        self._task = asyncio.current_task()

    def interrupted(self) -> None:
        """SIGINT."""
        if self.scanning and not self.control.stop.is_set():
            self._tell("finishing the line and closing; Ctrl-C again to cancel it.")
            self.control.stop.set()
        else:
            self.terminated()

    def terminated(self) -> None:
        """SIGTERM, or SIGINT again."""
        self._tell("cancelling: stopping the mirror, closing cube and devices.")
        if self._task is not None:
            self._task.cancel()

    def paused(self) -> None:
        """SIGUSR1."""
        if not self.scanning:
            self._tell("there is no scan to be paused.")
        elif not self.control.paused:
            self._tell("pausing after this line; Ctrl-Z again to go on.")
            self.control.pause()

    def gone_on(self) -> None:
        """SIGUSR2."""
        if self.control.paused:
            self._tell("going on.")
            self.control.go_on()

    def toggled(self) -> None:
        """SIGTSTP."""
        (self.gone_on if self.control.paused else self.paused)()


@contextmanager
def interrupts(tell: Callable[[str], None]) -> Generator[Interrupt]:
    """Handle SIGINT, SIGTERM, SIGTSTP, SIGUSR1 and SIGUSR2 in the running loop while entered. Main thread only."""
    loop = asyncio.get_running_loop()
    interrupt = Interrupt(tell)
    handlers = {
        signal.SIGINT: interrupt.interrupted,
        signal.SIGTERM: interrupt.terminated,
        signal.SIGTSTP: interrupt.toggled,
        signal.SIGUSR1: interrupt.paused,
        signal.SIGUSR2: interrupt.gone_on,
    }
    for number, handler in handlers.items():
        loop.add_signal_handler(number, handler)
    try:
        yield interrupt
    finally:
        for number in handlers:
            loop.remove_signal_handler(number)

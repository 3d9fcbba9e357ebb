"""How people, and programs for them, steer a scan that is under way."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field


@dataclass(slots=True, eq=False)
class ScanControl:
    """Stop, pause and go on. Call from the event loop, at any moment, also before the scan begins and when it is over.

    A pause finishes the line under way; then the mirror stands still, the camera is disarmed and what was taken is stored, until
    the scan is told to go on or to stop.

    Attributes:
        stop: Set it to finish the line under way and close. It cannot be taken back.
        standing: Whether the scan stands paused: set when the line under way is over, cleared as it goes on.
    """

    stop: asyncio.Event = field(default_factory=asyncio.Event)
    standing: asyncio.Event = field(default_factory=asyncio.Event)
    _pausing: asyncio.Event = field(default_factory=asyncio.Event)
    _going: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def paused(self) -> bool:
        """Whether a pause is asked for."""
        return self._pausing.is_set()

    @property
    def halted(self) -> bool:
        """Whether no further line is to be taken now."""
        return self.stop.is_set() or self._pausing.is_set()

    def pause(self) -> None:
        """Finish the line under way and wait."""
        self._going.clear()
        self._pausing.set()

    def go_on(self) -> None:
        """End a pause."""
        self._pausing.clear()
        self._going.set()

    async def until_halted(self) -> None:
        """Wait for a stop or a pause to be asked for."""
        await _first_of(self.stop, self._pausing)

    async def until_going(self) -> None:
        """Wait for the end of the pause, or a stop."""
        if self.paused:
            await _first_of(self.stop, self._going)


async def _first_of(*events: asyncio.Event) -> None:
    waits = [asyncio.ensure_future(event.wait()) for event in events]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)

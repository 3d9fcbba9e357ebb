"""What happens, told to everybody who listens, without ever waiting for one of them."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

QUEUE: Final = 256
"""Events kept for a listener that is slow; then the oldest are dropped, and their number is told."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened.

    Attributes:
        seq: Counts all events of a station.
        time: When, ISO 8601, UTC.
        type: What kind: ``state``, ``job``, ``progress``, ``lease``, ``log``.
        data: Plain JSON types.
    """

    seq: int
    time: str
    type: str
    data: dict[str, Any]


class Subscription:
    """The queue of one listener."""

    def __init__(self) -> None:
        self._waiting: deque[Event] = deque(maxlen=QUEUE)
        self._arrived = asyncio.Event()
        self._dropped = 0

    def put(self, event: Event) -> None:
        """Queue an event; progress that nobody has taken yet is replaced."""
        if event.type == "progress" and self._waiting and self._waiting[-1].type == "progress":
            self._waiting.pop()
        elif len(self._waiting) == QUEUE:
            self._dropped += 1
        self._waiting.append(event)
        self._arrived.set()

    async def next(self) -> tuple[Event, int]:
        """The next event, and how many were dropped before it."""
        while not self._waiting:
            self._arrived.clear()
            await self._arrived.wait()
        dropped, self._dropped = self._dropped, 0
        return self._waiting.popleft(), dropped


class Events:
    """Tells everybody."""

    def __init__(self) -> None:
        self._seq = 0
        self._listeners: set[Subscription] = set()

    @property
    def listeners(self) -> int:
        """How many there are."""
        return len(self._listeners)

    def publish(self, type: str, data: dict[str, Any]) -> None:
        """Tell what happened; returns at once."""
        self._seq += 1
        event = Event(self._seq, datetime.now(UTC).isoformat(timespec="milliseconds"), type, data)
        for listener in self._listeners:
            listener.put(event)

    @contextmanager
    def subscribed(self) -> Generator[Subscription]:
        """Listen while entered."""
        subscription = Subscription()
        self._listeners.add(subscription)
        try:
            yield subscription
        finally:
            self._listeners.discard(subscription)

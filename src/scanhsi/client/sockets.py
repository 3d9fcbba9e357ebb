"""What happens at a remote instrument, and what it sees, as asynchronous iterators."""

from __future__ import annotations

import json
import ssl
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from scanhsi.devices.errors import DeviceLost


@dataclass(frozen=True, slots=True)
class Happened:
    """An event of the service.

    Attributes:
        type: ``hello``, ``state``, ``job``, ``progress``, ``lease``, ``log``.
        data: What it tells.
        dropped: Events that were lost before it, because we were slow.
    """

    type: str
    data: dict[str, Any]
    dropped: int


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """A picture of the live view, or rows of the colour picture of a scan.

    Attributes:
        kind: ``frame`` or ``rows``.
        facts: Statistics and place, as the service describes them.
        pixels: uint8, (bands, samples) or (rows, samples, 3).
    """

    kind: str
    facts: dict[str, Any]
    pixels: NDArray[np.uint8]


async def events(url: str, token: str | None, tls: ssl.SSLContext | None = None) -> AsyncGenerator[Happened]:
    """What happens, from now on. Close it (`contextlib.aclosing`) to close the connection at once."""
    async with aclosing(_messages(f"{url}/events", token, tls)) as messages:
        async for message in messages:
            told: dict[str, Any] = json.loads(message)
            yield Happened(told["type"], told["data"], told["dropped"])


async def preview(
    url: str, token: str | None, fps: float, tls: ssl.SSLContext | None = None
) -> AsyncGenerator[SeenFrame]:
    """What is seen, the latest only. Close it as `events`."""
    async with aclosing(_messages(f"{url}/preview?fps={fps:g}", token, tls)) as messages:
        async for message in messages:
            assert isinstance(message, bytes), "pictures are binary"
            length = int.from_bytes(message[:4], "little")
            facts: dict[str, Any] = json.loads(message[4 : 4 + length])
            pixels = np.frombuffer(message, np.uint8, offset=4 + length).reshape(facts["shape"])
            yield SeenFrame(facts["kind"], facts, pixels)


async def _messages(url: str, token: str | None, tls: ssl.SSLContext | None) -> AsyncGenerator[str | bytes]:
    address = url.replace("http", "ws", 1)
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    try:
        async with connect(
            address, ssl=tls, additional_headers=headers, max_size=64_000_000, compression=None
        ) as socket:
            async for message in socket:
                yield message
    except (OSError, ConnectionClosed) as error:
        raise DeviceLost(f"the connection broke: {error}.", device=url) from error

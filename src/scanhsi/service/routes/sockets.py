"""WebSockets: what happens, and live pictures. Both only send; each viewer waits for itself alone."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from typing import Annotated, Any, Final, cast

from fastapi import APIRouter, Query, WebSocket, WebSocketDisconnect

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.service.preview import MOST_A_SECOND
from scanhsi.service.routes.common import station_of
from scanhsi.service.security import Guard, Security

router = APIRouter()
TOKEN_WITHIN_S: Final = 5.0
_LONGEST_MESSAGE: Final = 2000
_MOST_MESSAGES: Final = 20
"""Messages of a viewer that are let pass: the token, and signs of life. More is a flood."""
_POLICY: Final = 1008


@router.websocket("/events")
async def events(socket: WebSocket) -> None:
    """JSON messages ``{"seq", "time", "type", "data", "dropped"}``, beginning with one of type ``hello`` that has the state."""
    station = station_of(socket)

    async def tell() -> None:
        with station.events.subscribed() as subscription:
            await socket.send_json({"seq": 0, "type": "hello", "data": station.state(), "dropped": 0})
            while True:
                event, dropped = await subscription.next()
                await socket.send_json({**asdict(event), "dropped": dropped})

    await _serve(socket, tell)


@router.websocket("/preview")
async def preview(socket: WebSocket, fps: Annotated[float, Query(gt=0, le=MOST_A_SECOND)] = MOST_A_SECOND) -> None:
    """Binary messages: length of the header (uint32, little-endian), header (JSON), pixels (uint8)."""
    station = station_of(socket)

    async def show() -> None:
        with station.preview.viewing() as viewer:
            while True:
                began_ns = now_ns()
                for message in await viewer.next():
                    await socket.send_bytes(message)
                await sleep_until_ns(began_ns + round(1e9 / fps))

    await _serve(socket, show)


async def _serve(socket: WebSocket, send: Callable[[], Awaitable[None]]) -> None:
    """Send until the viewer goes, or misbehaves."""
    await socket.accept()
    if not await _authorized(socket):
        return
    sending = asyncio.ensure_future(send())
    listening = asyncio.ensure_future(_listen(socket))
    try:
        await asyncio.wait([sending, listening], return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, listening):
            task.cancel()
        results = await asyncio.gather(sending, listening, return_exceptions=True)
    if results[1] is True:
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await socket.close(_POLICY, "too many messages: nothing is expected here")


async def _listen(socket: WebSocket) -> bool:
    """Hear the end of the connection; True when the viewer sends more than a viewer should."""
    for _ in range(_MOST_MESSAGES):
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return False
        if len(message.get("text") or message.get("bytes") or "") > _LONGEST_MESSAGE:
            return True
    return True


async def _authorized(socket: WebSocket) -> bool:
    """Where a token is needed and no header brought it, the first message does: ``{"token": "..."}``."""
    security = cast("Security", socket.app.state.security)
    if security.token is None or socket.headers.get("authorization"):  # the guard looked at that
        return True
    try:
        async with asyncio.timeout(TOKEN_WITHIN_S):
            text = await socket.receive_text()
        first: Any = json.loads(text[:_LONGEST_MESSAGE])
        token = cast("dict[str, Any]", first).get("token") if isinstance(first, dict) else None
    except (TimeoutError, ValueError, KeyError, WebSocketDisconnect):
        token = None
    guard = cast("Guard", socket.app.state.guard)
    if isinstance(token, str) and not guard.too_many_failures(socket.scope) and security.accepts(token):
        return True
    guard.count_failure(socket.scope)
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(_POLICY, "the token is missing or wrong")
    return False

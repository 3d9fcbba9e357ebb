"""Commands that may be sent twice and are done once: those with the header ``Idempotency-Key``.

A command whose answer was lost is sent again with the same key, and gets the same answer; the mirror does not move twice. The same
key with another command is refused. Taking control is left out: its answer is a secret.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Final

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from scanhsi.clock import now_ns
from scanhsi.service.problems import MEDIA_TYPE, problem_of
from scanhsi.service.refusals import KeyReused, Refused

KEPT: Final = 256
KEPT_S: Final = 600.0
LONGEST_KEY: Final = 200


@dataclass(slots=True)
class _Answer:
    fingerprint: bytes
    at_ns: int
    messages: asyncio.Future[list[Message]]


class Idempotency:
    """Remembers the answers to commands that have a key.

    Args:
        app: What carries them out.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._answers: OrderedDict[str, _Answer] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        key = self._key(scope)
        if key is None:
            await self.app(scope, receive, send)
            return
        body = (await receive()).get("body", b"")  # the guard hands it over in one piece
        fingerprint = hashlib.sha256(f"{scope['method']} {scope['path']}\n".encode() + body).digest()
        self._forget()
        known = self._answers.get(key)
        if known is None:
            await self._first(key, fingerprint, body, scope, receive, send)
        elif known.fingerprint != fingerprint:
            await _refuse(KeyReused("this Idempotency-Key was used for another command.", hint="a new key"), send)
        else:
            await _replay(await asyncio.shield(known.messages), send)

    def _key(self, scope: Scope) -> str | None:
        if scope["type"] != "http" or scope["method"] in ("GET", "HEAD", "OPTIONS") or scope["path"].endswith("/lease"):
            return None
        return Headers(scope=scope).get("idempotency-key", "")[:LONGEST_KEY] or None

    async def _first(
        self, key: str, fingerprint: bytes, body: bytes, scope: Scope, receive: Receive, send: Send
    ) -> None:
        answer = _Answer(fingerprint, now_ns(), asyncio.get_running_loop().create_future())
        self._answers[key] = answer
        messages: list[Message] = []
        handed_over = False

        async def hand_over() -> Message:
            nonlocal handed_over
            if handed_over:
                return await receive()
            handed_over = True
            return {"type": "http.request", "body": body, "more_body": False}

        async def keep(message: Message) -> None:
            messages.append(message)
            await send(message)

        try:
            await self.app(scope, hand_over, keep)
        finally:
            status = messages[0]["status"] if messages else 500
            if status < 400:
                answer.messages.set_result(messages)
            else:  # it was not done: it may be tried again
                del self._answers[key]
                answer.messages.set_result(messages or _problem(Refused("the command failed.")))

    def _forget(self) -> None:
        oldest = now_ns() - round(KEPT_S * 1e9)
        for key in [key for key, answer in self._answers.items() if answer.messages.done()]:
            if self._answers[key].at_ns < oldest or len(self._answers) >= KEPT:
                del self._answers[key]


async def _replay(messages: list[Message], send: Send) -> None:
    start: dict[str, Any] = dict(messages[0])
    await send({**start, "headers": [*start["headers"], (b"idempotency-replayed", b"true")]})
    for message in messages[1:]:
        await send(message)


async def _refuse(refusal: Refused, send: Send) -> None:
    for message in _problem(refusal):
        await send(message)


def _problem(refusal: Refused) -> list[Message]:
    body = json.dumps(problem_of(refusal)).encode()
    headers = [(b"content-type", MEDIA_TYPE.encode()), (b"content-length", str(len(body)).encode())]
    return [
        {"type": "http.response.start", "status": refusal.status, "headers": headers},
        {"type": "http.response.body", "body": body, "more_body": False},
    ]

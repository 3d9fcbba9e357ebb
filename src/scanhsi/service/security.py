"""Who may talk to the service: the guard in front of it, as plain ASGI.

* **Token.** Where one is set, every request under ``/api`` carries it: ``Authorization: Bearer ...``; a WebSocket of a browser,
  which cannot, sends it as its first message. Never in a URL, which is logged; compared in constant time.
* **Other sites.** A page of another site can make a browser send requests here. They carry ``Origin``, which has to be this
  service's own; and ``Host`` has to be a name of this computer, so that no foreign name can be pointed at it (DNS rebinding).
* **Sizes and rates.** Bodies are short, requests and wrong tokens are counted, WebSockets are few.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import time
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from scanhsi.log import get_logger
from scanhsi.service.problems import MEDIA_TYPE, problem_of
from scanhsi.service.refusals import CrossSite, Refused, TooLarge, TooMany, TooSlow, Unauthorized

LARGEST_BODY: Final = 1_000_000
BODY_WITHIN_S: Final = 20.0
MOST_SOCKETS: Final = 64
_ADDRESSES: Final = 1024
_SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS"})
_HEADERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (
        b"content-security-policy",
        b"default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; connect-src 'self' ws: wss:; "
        b"frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    ),
)
_log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Security:
    """What is asked of those who connect.

    Attributes:
        token: They have to show it; None asks for none, which is for loopback only.
        hosts: Names by which this service may be called, besides IP addresses and localhost.
        requests_s: Requests a second and address, on average.
        burst: Requests at once.
        failures_s: Wrong tokens a second and address.
    """

    token: str | None = None
    hosts: frozenset[str] = frozenset()
    requests_s: float = 100.0
    burst: float = 300.0
    failures_s: float = 0.5

    def accepts(self, token: str | None) -> bool:
        """Whether a token is the right one, in a time that does not tell how much of it is."""
        if self.token is None:
            return True
        return hmac.compare_digest((token or "").encode(), self.token.encode())

    def knows(self, host: str) -> bool:
        """Whether this service is called so."""
        name = _name_of(host)
        if name is None:
            return False
        if name == "localhost" or name in self.hosts:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True  # no name that somebody else could have pointed here


def _name_of(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


@dataclass(slots=True)
class Buckets:
    """A token bucket an address, for the last addresses.

    Attributes:
        rate_s: Refilled so fast.
        size: As much as may be taken at once.
    """

    rate_s: float
    size: float
    _levels: OrderedDict[str, tuple[float, float]] = field(default_factory=OrderedDict[str, tuple[float, float]])

    def take(self, address: str, now_s: float) -> bool:
        """Take one; False when there is none."""
        level, then_s = self._levels.pop(address, (self.size, now_s))
        level = min(self.size, level + (now_s - then_s) * self.rate_s)
        self._levels[address] = (level - 1 if level >= 1 else level, now_s)
        while len(self._levels) > _ADDRESSES:
            self._levels.popitem(last=False)
        return level >= 1

    def empty(self, address: str, now_s: float) -> bool:
        """Whether there is none, without taking."""
        level, then_s = self._levels.get(address, (self.size, now_s))
        return level + (now_s - then_s) * self.rate_s < 1


class Guard:
    """Lets through what may come.

    Args:
        app: Behind it.
        security: What is asked.
    """

    def __init__(self, app: ASGIApp, security: Security) -> None:
        self._app = app
        self._security = security
        self._requests = Buckets(security.requests_s, security.burst)
        self._failures = Buckets(security.failures_s, 10)
        self._sockets = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request or WebSocket."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        try:
            self._check(scope)
        except Refused as refusal:
            await _refuse(refusal, scope, receive, send)
            return
        if scope["type"] == "websocket":
            self._sockets += 1
            try:
                await self._app(scope, receive, send)
            finally:
                self._sockets -= 1
            return
        await self._http(scope, receive, send)

    def _check(self, scope: Scope) -> None:
        security, headers = self._security, Headers(scope=scope)
        if not self._requests.take(_address(scope), time.monotonic()):
            raise TooMany("too many requests.", hint="slow down; events come over the WebSocket /api/v1/events")
        if scope["type"] == "websocket" and self._sockets >= MOST_SOCKETS:
            raise TooMany(f"{MOST_SOCKETS} WebSockets are open already.")
        host = headers.get("host", "")
        if not security.knows(host):
            raise CrossSite(
                f"this service is not called {host[:100]!r}.", hint="scanhsi serve --allow-host NAME, or its IP address"
            )
        _refuse_other_sites(scope, headers, host)
        if not scope["path"].startswith("/api/") or scope["path"].startswith("/api/v1/downloads/"):
            return  # the page itself: no secret in it; a download that was prepared: its address is the secret
        if security.token is None:
            return
        shown = _bearer(headers)
        if shown is None and scope["type"] == "websocket":
            return  # its first message tells; see `sockets`
        if self.too_many_failures(scope):
            raise TooMany("too many wrong tokens.", hint="wait a minute")
        if not security.accepts(shown):
            self.count_failure(scope)
            raise Unauthorized("the token is missing or wrong.", hint="Authorization: Bearer TOKEN")

    def too_many_failures(self, scope: Scope) -> bool:
        """Whether too many wrong tokens came from there."""
        return self._failures.empty(_address(scope), time.monotonic())

    def count_failure(self, scope: Scope) -> None:
        """A wrong token came, or none."""
        self._failures.take(_address(scope), time.monotonic())
        _log.warning("wrong token, or none", operation="authorize", address=_address(scope))

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        length = Headers(scope=scope).get("content-length")
        if length is not None and (not length.isdigit() or int(length) > LARGEST_BODY):
            await _refuse(_too_large(), scope, receive, send)
            return
        try:
            async with asyncio.timeout(BODY_WITHIN_S):
                body = await _body(receive) if scope["method"] not in _SAFE else b""
        except TimeoutError:
            await _refuse(TooSlow(f"the body did not come within {BODY_WITHIN_S:g} s."), scope, receive, send)
            return
        if body is None:
            await _refuse(_too_large(), scope, receive, send)
            return
        replayed = False

        async def replay() -> Message:
            nonlocal replayed
            if replayed or scope["method"] in _SAFE:
                return await receive()
            replayed = True
            return {"type": "http.request", "body": body, "more_body": False}

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                names = {name.lower() for name, _ in message["headers"]}
                more = [pair for pair in _HEADERS if pair[0] not in names]
                if scope["path"].startswith("/api/") and b"cache-control" not in names:
                    more.append((b"cache-control", b"no-store"))
                message["headers"] = [*message["headers"], *more]
            await send(message)

        await self._app(scope, replay, send_with_headers)


def _address(scope: Scope) -> str:
    return (scope.get("client") or ("?", 0))[0]


def _refuse_other_sites(scope: Scope, headers: Headers, host: str) -> None:
    changes = scope["type"] == "websocket" or scope["method"] not in _SAFE
    origin = headers.get("origin")
    if changes and origin is not None:
        parts = urlsplit(origin) if origin != "null" else None
        if parts is None or parts.netloc.lower() != host.lower():
            raise CrossSite(f"a page of {origin[:100]} sent this.", hint="use the page of the service itself")
    if changes and headers.get("sec-fetch-site") in ("cross-site", "same-site"):
        raise CrossSite("a page of another site sent this.", hint="use the page of the service itself")


def _bearer(headers: Headers) -> str | None:
    kind, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if kind.lower() == "bearer" and token.strip() else None


async def _body(receive: Receive) -> bytes | None:
    """The whole body; None when it is too long."""
    parts: list[bytes] = []
    size = 0
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return b"".join(parts)
        part = message.get("body", b"")
        size += len(part)
        if size > LARGEST_BODY:
            return None
        parts.append(part)
        if not message.get("more_body", False):
            return b"".join(parts)


def _too_large() -> TooLarge:
    return TooLarge(f"the body is longer than {LARGEST_BODY} bytes.")


async def _refuse(refusal: Refused, scope: Scope, receive: Receive, send: Send) -> None:
    body = json.dumps(problem_of(refusal)).encode()
    headers: Iterable[tuple[bytes, bytes]] = [
        (b"content-type", MEDIA_TYPE.encode()),
        (b"content-length", str(len(body)).encode()),
        *_HEADERS,
    ]
    if refusal.status == 401:
        headers = [*headers, (b"www-authenticate", b"Bearer")]
    if refusal.status == 429:
        headers = [*headers, (b"retry-after", b"5")]
    prefix = "http"
    if scope["type"] == "websocket":
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008})
            return
        prefix = "websocket.http"
    else:
        headers = [*headers, (b"connection", b"close")]
    await send({"type": f"{prefix}.response.start", "status": refusal.status, "headers": list(headers)})
    await send({"type": f"{prefix}.response.body", "body": body, "more_body": False})

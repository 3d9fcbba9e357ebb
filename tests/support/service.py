"""The service in this process: an instrument in virtual time, its ASGI application, clients without sockets."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

import scanhsi
from scanhsi.clock import run
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi.service.app import create_app
from scanhsi.service.security import Security
from scanhsi.service.station import Station, open_station
from support.small import SMALL as PART

SMALL = {**PART, "storage.durability": "at close"}
BASE = "http://localhost/api/v1"


def small(**settings: Any) -> InstrumentConfig:
    return load_instrument("sensors2019", {**SMALL, **settings})


@dataclass
class Service:
    """An application, its station, and a client of it."""

    app: Any
    station: Station
    http: httpx.AsyncClient
    lease: dict[str, str] = field(default_factory=dict[str, str])

    async def take_control(self, name: str = "Ada") -> None:
        answer = await self.http.post("/lease", json={"name": name})
        assert answer.status_code == 201, answer.text
        self.http.headers["Scanhsi-Lease"] = answer.json()["id"]

    async def done(self, id: str) -> dict[str, Any]:
        """The job once it is over."""
        while True:
            job = (await self.http.get(f"/jobs/{id}", params={"wait_s": 30})).json()
            if job["ended"] is not None:
                return job

    async def scan(self, name: str, lines: int = 20) -> dict[str, Any]:
        answer = await self.http.post("/scans", json={"plan": {"lines": lines}, "output": name})
        assert answer.status_code == 201, answer.text
        return await self.done(answer.json()["id"])

    def socket(self, path: str, headers: dict[str, str] | None = None) -> Socket:
        return Socket(self.app, f"/api/v1{path}", headers or {})


@asynccontextmanager
async def open_service(
    folder: Path, config: InstrumentConfig | None = None, security: Security | None = None
) -> AsyncGenerator[Service]:
    security = security or Security(requests_s=1e6, burst=1e6)
    async with scanhsi.open_instrument(config or small()) as imager, open_station(imager, folder) as station:
        app = create_app(station, security)
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url=BASE) as http:
            yield Service(app, station, http)


def with_service(
    folder: Path,
    use: Callable[[Service], Coroutine[Any, Any, None]],
    config: InstrumentConfig | None = None,
    security: Security | None = None,
    *,
    virtual: bool = True,
) -> None:
    """Use a service in virtual time; where static files are read by threads that it does not know, in real time."""

    async def main() -> None:
        async with open_service(folder, config, security) as service:
            await use(service)

    run(main(), virtual=virtual)


class Socket:
    """A WebSocket without a network: what the application sends, and what it is sent."""

    def __init__(self, app: Any, path: str, headers: dict[str, str]) -> None:
        path, _, query = path.partition("?")
        given = {"host": "localhost", **{name.lower(): value for name, value in headers.items()}}
        self._scope: dict[str, Any] = {
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": "ws",
            "path": path,
            "raw_path": path.encode(),
            "query_string": query.encode(),
            "root_path": "",
            "headers": [(name.encode(), value.encode()) for name, value in given.items()],
            "client": ("127.0.0.1", 1),
            "server": ("localhost", 80),
            "subprotocols": [],
            "extensions": {"websocket.http.response": {}},
        }
        self._app = app
        self._to_app: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.from_app: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.stalled: asyncio.Event | None = None
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Socket:
        self._to_app.put_nowait({"type": "websocket.connect"})
        self._task = asyncio.ensure_future(self._app(self._scope, self._to_app.get, self._send))
        return self

    async def __aexit__(self, *error: object) -> None:
        del error
        assert self._task is not None
        self._to_app.put_nowait({"type": "websocket.disconnect", "code": 1000})
        if self.stalled is not None:
            self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=self.stalled is not None)

    async def _send(self, message: dict[str, Any]) -> None:
        if self.stalled is not None:
            await self.stalled.wait()
        self.from_app.put_nowait(message)

    def send(self, text: str) -> None:
        self._to_app.put_nowait({"type": "websocket.receive", "text": text})

    async def message(self) -> dict[str, Any]:
        """The next message of the application, as ASGI has it."""
        async with asyncio.timeout(30):
            return await self.from_app.get()

    async def json(self) -> dict[str, Any]:
        """The next text, decoded."""
        while True:
            message = await self.message()
            assert message["type"] in ("websocket.accept", "websocket.send"), message
            if "text" in message:
                return json.loads(message["text"])

    async def binary(self) -> tuple[dict[str, Any], bytes]:
        """The next picture: header and pixels."""
        while True:
            message = await self.message()
            assert message["type"] in ("websocket.accept", "websocket.send"), message
            if data := message.get("bytes"):
                length = int.from_bytes(data[:4], "little")
                return json.loads(data[4 : 4 + length]), data[4 + length :]


Use = Callable[[Service], Awaitable[None]]

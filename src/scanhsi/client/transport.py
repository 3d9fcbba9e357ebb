"""Requests to a service: errors as exceptions, control kept, commands that are sent again when their answer was lost."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any, Final, cast
from uuid import uuid4

import httpx

from scanhsi.client.errors import error_of
from scanhsi.devices.errors import ConfigError, DeviceBusy, DeviceLost, DeviceNotFound, ProtocolError

_TRIES: Final = 3
_TTL_S: Final = 60.0


class Transport:
    """The connection to one service.

    Args:
        http: With the base URL ``.../api/v1`` and the token.
        tls: Whom it trusts, for other connections to the same service.
        name: Under which control is taken.
    """

    def __init__(self, http: httpx.AsyncClient, tls: ssl.SSLContext | None, name: str) -> None:
        self.http = http
        self.tls = tls
        self._name = name
        self._lease: str | None = None
        self._taking = asyncio.Lock()
        self._heart: asyncio.Task[None] | None = None

    async def get(self, path: str, **query: Any) -> Any:
        """Ask.

        Raises:
            ScanhsiError: What the service tells.
            DeviceNotFound, DeviceLost: It does not answer.
        """
        return await self._send("GET", path, params={key: value for key, value in query.items() if value is not None})

    async def command(self, method: str, path: str, body: Any = None, *, control: bool = True) -> Any:
        """Command, once: with a key, so that it may be sent again when the connection breaks.

        Raises:
            DeviceBusy: Somebody else is in control.
            ScanhsiError: What the service tells.
            DeviceNotFound, DeviceLost: It does not answer.
        """
        headers = {"Idempotency-Key": uuid4().hex}
        if control:
            headers["Scanhsi-Lease"] = await self._control()
        for _ in range(_TRIES - 1):
            with contextlib.suppress(DeviceLost):
                return await self._send(method, path, headers=headers, json=body)
        return await self._send(method, path, headers=headers, json=body)

    async def fetch(self, path: str, file: Path, **query: str) -> None:
        """Save an answer as a file.

        Raises:
            ScanhsiError: As `get`.
        """
        try:
            async with self.http.stream("GET", path, params=query) as answer:
                if answer.is_error:
                    await answer.aread()
                    raise _refusal(answer)
                with file.open("wb") as out:
                    async for block in answer.aiter_bytes(1 << 20):
                        await asyncio.to_thread(out.write, block)
        except httpx.TransportError as error:
            raise self._gone(error) from error

    async def close(self) -> None:
        """Give control up."""
        if self._heart is not None:
            self._heart.cancel()
            await asyncio.gather(self._heart, return_exceptions=True)
        if self._lease is not None:
            with contextlib.suppress(Exception):  # it runs out by itself
                await self.http.delete("/lease", headers={"Scanhsi-Lease": self._lease})

    async def _control(self) -> str:
        async with self._taking:
            if self._lease is None:
                taken = await self._send("POST", "/lease", json={"name": self._name, "ttl_s": _TTL_S})
                self._lease = str(taken["id"])
                self._heart = asyncio.ensure_future(self._beat(self._lease))
            return self._lease

    async def _beat(self, lease: str) -> None:
        while True:
            await asyncio.sleep(_TTL_S / 4)
            try:
                await self._send("PUT", "/lease", headers={"Scanhsi-Lease": lease})
            except DeviceBusy:  # it ran out while we were not heard: taken again with the next command
                self._lease = None
                return
            except (DeviceLost, DeviceNotFound):
                continue

    async def _send(self, method: str, path: str, **more: Any) -> Any:
        try:
            answer = await self.http.request(method, path, **more)
        except httpx.TransportError as error:
            raise self._gone(error) from error
        if answer.is_error:
            raise _refusal(answer)
        return answer.json() if answer.content else None

    def _gone(self, error: httpx.TransportError) -> DeviceLost | DeviceNotFound:
        where = str(self.http.base_url)
        if "CERTIFICATE_VERIFY_FAILED" in str(error):
            return DeviceNotFound(
                f"its TLS certificate is not trusted: {error}.",
                device=where,
                hint="its certificate file: connect_instrument(..., certificate='cert.pem')",
            )
        if isinstance(error, httpx.ConnectError):
            return DeviceNotFound("nothing answers.", device=where, hint="scanhsi serve, at the instrument")
        return DeviceLost(f"the connection broke: {str(error).rstrip('.') or type(error).__name__}.", device=where)


def _refusal(answer: httpx.Response) -> Exception:
    try:
        problem: Any = answer.json()
    except json.JSONDecodeError:
        problem = None
    if isinstance(problem, dict):
        return error_of(cast("dict[str, Any]", problem))
    return ProtocolError(f"{answer.request.url} answered {answer.status_code}, and no problem details.")


@contextlib.asynccontextmanager
async def connected(
    url: str, token: str | None, name: str, certificate: str | Path | None, transport: httpx.AsyncBaseTransport | None
) -> AsyncGenerator[Transport]:
    """A transport, closed on leaving.

    Raises:
        ConfigError: The certificate cannot be read.
    """
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    base = f"{url.rstrip('/')}/api/v1"
    timeout = httpx.Timeout(60.0, connect=10.0)
    tls = _trusting(certificate)
    verify = True if tls is None else tls
    async with httpx.AsyncClient(
        base_url=base, headers=headers, timeout=timeout, transport=transport, verify=verify
    ) as http:
        opened = Transport(http, tls, name)
        try:
            yield opened
        finally:
            await opened.close()


def _trusting(certificate: str | Path | None) -> ssl.SSLContext | None:
    if certificate is None:
        return None
    try:
        return ssl.create_default_context(cafile=certificate)
    except OSError as error:  # SSLError is one
        raise ConfigError(f"the certificate {certificate} cannot be read: {error.strerror or error}.") from error

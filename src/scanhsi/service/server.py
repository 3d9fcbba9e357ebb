"""Runs the service on the loop of the scan, with uvicorn."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import logging
import signal
import socket
import ssl
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import uvicorn

from scanhsi.devices.errors import ConfigError
from scanhsi.imager import open_instrument
from scanhsi.instrument import InstrumentConfig
from scanhsi.log import as_json
from scanhsi.service.app import create_app
from scanhsi.service.security import LARGEST_BODY, Security
from scanhsi.service.station import Station, open_station

MOST_CONNECTIONS: Final = 256
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8
_FRAME_BYTES: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Serving:
    """How the service is reached.

    Attributes:
        host: Address to listen on.
        port: 0 takes a free one.
        security: What is asked of those who connect.
        certificate: TLS certificate, PEM.
        key: Its key, PEM.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    security: Security = field(default_factory=Security)
    certificate: Path | None = None
    key: Path | None = None


class _Server(uvicorn.Server):
    """uvicorn, leaving signals to us."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield


async def serve(config: InstrumentConfig, folder: Path, serving: Serving, *, told: Callable[[str], None]) -> None:
    """Open the instrument and serve it until SIGINT or SIGTERM.

    What is under way is then cancelled, which leaves valid cubes and a mirror at rest.

    Args:
        config: Of the instrument.
        folder: Data folder.
        serving: How it is reached.
        told: Called with the address once it listens.

    Raises:
        ConfigError: The address cannot be listened on, the certificate cannot be used.
        DeviceError: A device cannot be connected.
    """
    _check_certificate(serving)
    _give_frames_back()
    listening = _listen(serving)
    scheme = "http" if serving.certificate is None else "https"
    host, port = listening.getsockname()[:2]
    async with open_instrument(config) as imager, open_station(imager, folder) as station:
        server = _Server(
            uvicorn.Config(
                create_app(station, serving.security),
                ws="websockets-sansio",
                ws_per_message_deflate=False,  # pixels would cost more time than they save bytes
                ws_max_size=LARGEST_BODY,
                ws_ping_interval=20.0,
                access_log=False,
                log_config=None,
                lifespan="off",
                limit_concurrency=MOST_CONNECTIONS,
                server_header=False,
                timeout_keep_alive=30,
                timeout_graceful_shutdown=3,
                ssl_certfile=serving.certificate,
                ssl_keyfile=serving.key,
            )
        )
        with _ended_by_signals(server, station), _log_told(station):
            told(f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}")
            await server.serve(sockets=[listening])


def _check_certificate(serving: Serving) -> None:
    """Before anything is opened."""
    if serving.certificate is None:
        return
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(serving.certificate, serving.key)
    except OSError as error:  # SSLError is one
        raise ConfigError(
            f"the certificate {serving.certificate} with the key {serving.key} cannot be used: {error.strerror or error}.",
            hint="both as PEM, the key without a password: "
            "openssl req -x509 -newkey rsa:2048 -nodes -days 365 -subj /CN=$(hostname) "
            "-addext subjectAltName=DNS:$(hostname) -keyout key.pem -out cert.pem",
        ) from error


def _give_frames_back() -> None:
    """Have glibc return freed frames to the system at once; by itself each of its arenas comes to keep some."""
    with contextlib.suppress(OSError, AttributeError):  # another C library, which has ways of its own
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _FRAME_BYTES)
        libc.mallopt(_M_ARENA_MAX, 2)


def _listen(serving: Serving) -> socket.socket:
    family = socket.AF_INET6 if ":" in serving.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((serving.host, serving.port))
        listening.listen(128)
    except OSError as error:
        listening.close()
        raise ConfigError(
            f"cannot listen on {serving.host}, port {serving.port}: {error.strerror or error}.", hint="--port 0"
        ) from error
    return listening


class _ToStation(logging.Handler):
    """Events of the log, from whatever thread, on their way to the viewers."""

    def __init__(self, station: Station) -> None:
        super().__init__(logging.INFO)
        self._station = station
        self._loop = asyncio.get_running_loop()

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody listens
            self._loop.call_soon_threadsafe(self._station.log, as_json(record))


@contextlib.contextmanager
def _log_told(station: Station) -> Generator[None]:
    handler = _ToStation(station)
    logger = logging.getLogger("scanhsi")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


@contextlib.contextmanager
def _ended_by_signals(server: uvicorn.Server, station: Station) -> Generator[None]:
    loop = asyncio.get_running_loop()
    ending: list[asyncio.Task[None]] = []

    def end() -> None:
        ending.append(loop.create_task(station.close()))  # at once: connections are given some seconds
        server.force_exit = server.should_exit
        server.should_exit = True

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    try:
        yield
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)

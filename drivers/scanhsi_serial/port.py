"""Opening and closing the serial port without ever blocking the event loop.

pyserial-asyncio's own ``create_serial_connection`` opens the port in the event loop, and its ``close`` may wait for ever for a
peer that does not read; both are done here by hand.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any, TypeVar, cast

import serial
import serial_asyncio  # pyright: ignore[reportMissingTypeStubs]

from scanhsi.devices.errors import DeviceTimeout
from scanhsi_serial.errors import open_error

P = TypeVar("P", bound=asyncio.Protocol)

_OPEN_S = 5.0
_GIVEN_UP_S = 0.5
"""Time for an opening that was cancelled to come to its end."""


async def open_port(port: str, baud: int, factory: Callable[[], P], device: str) -> tuple[asyncio.Transport, P]:
    """Open `port` for this process alone and connect a protocol to it; messages call it `device`.

    ``connection_made`` of the protocol runs *after* this returns: it must be usable from its construction on.

    Raises:
        DeviceNotFound, DeviceBusy, DeviceUnavailable: See `open_error`.
        DeviceTimeout: The operating system does not open it.
    """
    opened = await _open_in_thread(port, baud, device)
    loop = asyncio.get_running_loop()
    return cast("tuple[asyncio.Transport, P]", await serial_asyncio.connection_for_serial(loop, factory, opened))


async def _open_in_thread(port: str, baud: int, device: str) -> Any:
    job = asyncio.get_running_loop().run_in_executor(None, _open, port, baud)
    try:
        async with asyncio.timeout(_OPEN_S):
            return await asyncio.shield(job)
    except BaseException as error:
        job.add_done_callback(
            _close_late
        )  # the thread goes on: a port that it still opens must not stay open, and locked
        if isinstance(error, asyncio.CancelledError):
            await asyncio.wait([job], timeout=_GIVEN_UP_S)  # else whoever opens it next finds it in use
        if isinstance(error, TimeoutError):
            raise DeviceTimeout("the port does not open.", device=device, waited_s=_OPEN_S) from None
        if isinstance(error, serial.SerialException | OSError | ValueError):
            raise open_error(error, port, device) from error
        raise


def _open(port: str, baud: int) -> Any:
    # exclusive: flock, so that a second driver gets an error instead of half of the bytes
    device = serial.serial_for_url(port, baudrate=baud, exclusive=True)
    with contextlib.suppress(ValueError, OSError, NotImplementedError, AttributeError):
        device.set_low_latency_mode(True)  # FTDI adapters hold bytes back for 16 ms otherwise; others have no such mode
    return device


def _close_late(job: asyncio.Future[Any]) -> None:
    if not job.cancelled() and job.exception() is None:
        job.result().close()


async def close_port(transport: asyncio.Transport, lost: asyncio.Event, deadline_s: float) -> None:
    """Close a port; after `deadline_s` throw away what the peer does not take. `lost` is set by ``connection_lost``."""
    device: Any = transport.get_extra_info("serial")
    if not lost.is_set() and device is not None:
        with contextlib.suppress(serial.SerialException, OSError, ValueError):
            device.reset_output_buffer()  # the transport drains the port in the event loop: leave it nothing to wait for
        transport.close()
    try:
        async with asyncio.timeout(deadline_s):
            await lost.wait()
    except TimeoutError:
        transport.abort()
        await lost.wait()

"""From what viva-genicam says to the errors of scanhsi.devices: the one place where that is decided.

The library has an exception for each layer, not for each cause; its words tell the cause.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    DeviceUnavailable,
    OutOfRange,
    ProtocolError,
    UnsupportedFeature,
)

_BY_WORDS: Final[tuple[tuple[str, type[DeviceError]], ...]] = (
    ("ACCESS_DENIED", DeviceBusy),
    ("claim control", DeviceBusy),  # it answered the broadcast: some cameras do not even refuse a second program
    ("control of the camera was lost", DeviceLost),
    ("is closed", DeviceLost),
    ("I/O failed: io:", DeviceLost),  # of the operating system: refused, unreachable, no such device
    ("above the maximum", OutOfRange),
    ("below the minimum", OutOfRange),
    ("increment", OutOfRange),
    ("not found", UnsupportedFeature),
    ("no entry named", UnsupportedFeature),
    ("not available", UnsupportedFeature),
    ("not implemented", UnsupportedFeature),
    ("access mode forbids", UnsupportedFeature),
    ("timeout", DeviceTimeout),
    ("timed out", DeviceTimeout),
)
_HINTS: Final[dict[type[DeviceError], str]] = {
    DeviceNotFound: "power and cable of the camera, its address (same subnet as this computer), a firewall on UDP 3956.",
    DeviceBusy: "close the other program that controls the camera; after a crash its hold ends within some seconds.",
    DeviceLost: "power and cable of the camera; close it and connect again.",
}


def device_name(address: str) -> str:
    """How messages call the camera at an address."""
    return f"camera genicam {address}"


def make(kind: type[DeviceError], message: str, device: str, operation: str | None = None) -> DeviceError:
    """An error with the hint that goes with its kind."""
    return kind(message, device=device, operation=operation, hint=_HINTS.get(kind))


def classify(message: str) -> type[DeviceError]:
    """The kind of error that the library's words mean."""
    return next((kind for words, kind in _BY_WORDS if words in message), ProtocolError)


@contextmanager
def translated(device: str, operation: str) -> Generator[None]:
    """Raise what viva-genicam raises inside as an error of scanhsi, from the original."""
    try:
        from viva_genicam import GenicamError
    except ImportError as error:
        raise DeviceUnavailable(
            f"viva-genicam cannot be imported: {error}", device=device, hint='pip install "scanhsi[genicam]"'
        ) from error
    try:
        yield
    except GenicamError as error:
        raise make(classify(str(error)), f"viva-genicam says: {error}.", device, operation) from error

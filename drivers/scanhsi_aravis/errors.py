"""From Aravis' errors to those of scanhsi: one table.

Aravis raises ``GLib.Error`` with a domain and a code; the codes of its two domains are the enumerations ``Aravis.DeviceError``
(what the camera or the link did) and ``Aravis.GcError`` (what the camera's GenICam description says). The tables are keyed by
the enumerations' nicknames, and a test walks the enumerations of the installed Aravis.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any

from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    OutOfRange,
    ProtocolError,
    UnsupportedFeature,
)
from scanhsi_aravis.lib import load

DEVICE_ERRORS: Mapping[str, type[DeviceError]] = {
    "wrong-feature": UnsupportedFeature,
    "feature-not-found": UnsupportedFeature,
    "not-connected": DeviceLost,
    "protocol-error": ProtocolError,
    "transfer-error": ProtocolError,
    "timeout": DeviceLost,  # Aravis has asked five times in 2.5 s by then
    "not-found": DeviceNotFound,
    "invalid-parameter": OutOfRange,
    "genicam-not-found": ProtocolError,
    "no-stream-channel": UnsupportedFeature,
    "not-controller": DeviceBusy,
    "unknown": ProtocolError,
    "protocol-error-not-implemented": UnsupportedFeature,
    "protocol-error-invalid-parameter": OutOfRange,
    "protocol-error-invalid-address": ProtocolError,
    "protocol-error-write-protect": UnsupportedFeature,
    "protocol-error-bad-alignment": ProtocolError,
    "protocol-error-access-denied": DeviceBusy,
    "protocol-error-busy": DeviceBusy,
}

GENICAM_ERRORS: Mapping[str, type[DeviceError]] = {
    "property-not-defined": ProtocolError,
    "pvalue-not-defined": ProtocolError,
    "invalid-pvalue": ProtocolError,
    "empty-enumeration": ProtocolError,
    "out-of-range": OutOfRange,
    "no-device-set": ProtocolError,
    "no-event-implementation": UnsupportedFeature,
    "node-not-found": UnsupportedFeature,
    "enum-entry-not-found": UnsupportedFeature,
    "invalid-length": ProtocolError,
    "read-only": UnsupportedFeature,
    "set-from-string-undefined": ProtocolError,
    "get-as-string-undefined": ProtocolError,
    "invalid-bit-range": ProtocolError,
    "invalid-syntax": ProtocolError,
}

HINTS: Mapping[type[DeviceError], str] = {
    DeviceNotFound: "power and cable of the camera, its address (same subnet as this computer), a firewall on UDP 3956.",
    DeviceBusy: "close the other program that controls the camera; after a crash its hold ends within 3 s.",
    DeviceLost: "power and cable of the camera; close it and connect again.",
}


def translate(error: Any, *, device: str, operation: str) -> DeviceError:
    """The error of scanhsi for a ``GLib.Error``.

    Args:
        error: With ``domain``, ``code`` and ``message``.
        device: Name of the device, for the message.
        operation: What was being done.
    """
    kind = classify(error.domain, error.code)
    return kind(f"Aravis says: {error.message}.", device=device, operation=operation, hint=HINTS.get(kind))


def classify(domain: str, code: int) -> type[DeviceError]:
    """The class for a code of a GLib error domain; `DeviceError` itself for one that is in no table."""
    aravis = load().aravis
    for quark, enumeration, table in (
        ("arv-device-error-quark", aravis.DeviceError, DEVICE_ERRORS),
        ("arv-gc-error-quark", aravis.GcError, GENICAM_ERRORS),
    ):
        if domain == quark:
            member = enumeration.__enum_values__.get(code)
            return table.get(member.value_nick if member is not None else "", DeviceError)
    return DeviceError


@contextmanager
def translated(device: str, operation: str) -> Generator[None]:
    """Raise what Aravis raises inside as an error of scanhsi, from the original."""
    try:
        yield
    except load().error as error:
        # Its traceback would keep the frames, and with them the camera object and its heartbeat thread, alive.
        raise translate(error, device=device, operation=operation) from error.with_traceback(None)

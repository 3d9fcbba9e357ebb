"""Opening a device anew: after it was lost, in mid-scan or long before."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Literal

from scanhsi.devices import Actuator, ActuatorInfo, Camera, CameraInfo, Light, LightInfo
from scanhsi.devices.errors import DeviceError, DeviceNotFound, PositionLost, UnsupportedFeature
from scanhsi.engine.cleanup import CleanupStep, clean_up
from scanhsi.engine.deadlines import CLOSE_S, CONNECT_S, STOP_S, Part, Watch
from scanhsi.instrument import Instrument
from scanhsi.log import get_logger

DeviceRole = Literal["camera", "actuator", "light"]
"""What a device is to its instrument."""

_log = get_logger(__name__)


async def reopen(instrument: Instrument, role: DeviceRole) -> None:
    """Close a device and connect it anew, once. Nothing moves: a mirror is told to stop then, and a light to go off.

    Settings and home position are not brought back here: a scan sets its camera up and homes its mirror where that is due.

    Args:
        instrument: Whose device.
        role: Which; lost, closed or well.

    Raises:
        DeviceNotFound: Nothing answers there, or another device than before.
        DeviceError: As its ``connect``, or it did not end in time. The device is closed.
        DeviceUnsafe: It did not confirm that it is at rest. The device is closed.
        PositionLost: It is open; but nobody knows where the mirror stands, and this drive cannot find its home by itself.
        UnsupportedFeature: The instrument has no light.
    """
    part, device = Part(role), _device(instrument, role)
    before = _info(instrument, role)
    stood_at = _stands_at(instrument.actuator) if part is Part.ACTUATOR else None
    watch = Watch({part: before.name})
    await close_anyhow(watch, part, device.close)
    try:
        async with watch(part, CONNECT_S, "connect"):
            await device.connect()
        check_identity(before, device.info)
        if failures := await clean_up(_to_rest(instrument, part, before.name)):
            raise failures[0]
    except BaseException:
        await close_anyhow(watch, part, device.close)
        raise
    _log.info("back", device=before.name, operation="reopen")
    if stood_at is not None and not instrument.actuator_info.finds_home and _stands_at(instrument.actuator) != stood_at:
        raise position_lost(before.name, "reopen")


def _device(instrument: Instrument, role: DeviceRole) -> Camera | Actuator | Light:
    device = {"camera": instrument.camera, "actuator": instrument.actuator, "light": instrument.light}[role]
    if device is None:
        raise UnsupportedFeature("it has no light.", device=instrument.config.name, operation="reopen")
    return device


def _info(instrument: Instrument, role: DeviceRole) -> CameraInfo | ActuatorInfo | LightInfo:
    infos = {"camera": instrument.camera_info, "actuator": instrument.actuator_info, "light": instrument.light_info}
    info = infos[role]
    assert info is not None, "whoever has a light knows what it is"
    return info


def _stands_at(actuator: Actuator) -> int | None:
    """Where the mirror is known to stand."""
    try:
        return actuator.position if actuator.homed else None
    except DeviceError:
        return None


def _to_rest(instrument: Instrument, part: Part, name: str) -> list[CleanupStep]:
    """It may have gone on with what it was told last; a camera that was just connected exposes nothing."""
    if part is Part.ACTUATOR:
        return [
            CleanupStep(
                "stop the mirror", instrument.actuator.stop, STOP_S, device=name, unsafe="the mirror may be moving"
            )
        ]
    if part is Part.LIGHT and instrument.light is not None:
        return [
            CleanupStep("switch the light off", instrument.light.off, STOP_S, device=name, unsafe="the light may be on")
        ]
    return []


async def close_anyhow(watch: Watch, part: Part, close: Callable[[], Awaitable[None]]) -> None:
    """Close a device that may be gone: what matters is whether it can be opened."""
    try:
        async with watch(part, CLOSE_S, "close"):
            await close()
    except Exception as error:
        _log.info("did not close", device=watch.names[part], operation="recover", error=str(error))


def position_lost(device: str, operation: str) -> PositionLost:
    """The error where steps mean nothing any more, and cannot be made to."""
    return PositionLost(
        "nobody knows where the mirror stands, and this drive cannot find its home by itself.",
        device=device,
        operation=operation,
        hint="a home switch; or set the mirror by hand and scan anew.",
    )


def check_identity(before: CameraInfo | ActuatorInfo | LightInfo, now: CameraInfo | ActuatorInfo | LightInfo) -> None:
    """See that it is the device that went, not another one at its address.

    Raises:
        DeviceNotFound: It is another.
    """
    if _identity(before) != _identity(now):
        raise DeviceNotFound(
            "another device answers there, or the same with another firmware.",
            device=now.name,
            hint="the one that went; or open the instrument anew (restart the service) to work with this one.",
        )


def _identity(info: CameraInfo | ActuatorInfo | LightInfo) -> tuple[str, ...]:
    told = (info.model, info.firmware)
    return (*told, info.vendor, info.serial) if isinstance(info, CameraInfo) else told

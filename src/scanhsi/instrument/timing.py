"""The delays of an instrument, from its file alone: nothing is connected."""

from __future__ import annotations

from collections.abc import Sequence

from scanhsi.devices.errors import ConfigError
from scanhsi.instrument.config import InstrumentConfig
from scanhsi.instrument.device_config import DeviceConfig
from scanhsi.timing.delays import DelayProfile
from scanhsi.timing.devices import (
    ACTUATOR_STREAMS,
    CAMERA_STREAMS,
    DeviceTiming,
    InstrumentTiming,
    with_transfer,
)


def timing_of(
    config: InstrumentConfig, profile: DelayProfile | None = None, *, packet_size: int = 1500
) -> InstrumentTiming:
    """What is known of the delays of an instrument.

    Args:
        config: Its file.
        profile: Delays of both devices, instead of those that the drivers tell.
        packet_size: Of the stream packets, from which the transfer time of a region of interest is computed where neither the
            driver nor the profile has one.

    Raises:
        ConfigError: A driver tells nothing and there is no profile.
    """
    camera, actuator = _told(config.camera), _told(config.actuator)
    roi = config.roi.roi.shape if config.roi else None
    if profile is not None:
        seed = camera.seed if camera else 0
        if camera is None and roi is not None:
            profile = with_transfer(profile, roi, packet_size)
        camera = (
            DeviceTiming(profile, seed, camera.sensor, camera.whole_transfer, camera.overlap)
            if camera
            else DeviceTiming(profile)
        )
        actuator = DeviceTiming(profile, actuator.seed if actuator else 0)
    if camera is None or actuator is None:
        pairs = ((config.camera, camera, CAMERA_STREAMS), (config.actuator, actuator, ACTUATOR_STREAMS))
        raise ConfigError(
            f"the delays of instrument {config.name} are not known:",
            [_missing(device, streams) for device, told, streams in pairs if told is None],
            hint="measure them and give them with --delays PROFILE.json.",
        )
    return InstrumentTiming(camera, actuator, roi)


def _told(device: DeviceConfig) -> DeviceTiming | None:
    backend = device.backend
    told = backend.timing(device.options) if backend.timing else None
    if told is not None and not isinstance(told, DeviceTiming):
        raise TypeError(f"{device.role.word} driver {device.driver!r}: timing returned a {type(told).__name__}")
    return told


def _missing(device: DeviceConfig, streams: Sequence[str]) -> str:
    return f"{device.role.word}.driver = {device.driver!r} does not tell {', '.join(streams)}"

"""The delays of an instrument, from its file alone: nothing is connected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from scanhsi.devices.errors import ConfigError
from scanhsi.instrument.config import InstrumentConfig
from scanhsi.instrument.device_config import DeviceConfig
from scanhsi.timing.delays import DelayProfile, DelayStreams
from scanhsi.timing.devices import (
    ACTUATOR_STREAMS,
    CAMERA_STREAMS,
    DeviceTiming,
    InstrumentTiming,
    with_transfer,
)

_TELLS_NOTHING: Final = DeviceTiming(
    DelayProfile(schema=1, name="none", source="The driver tells no delays.", mark="not known", streams={}),
    complete=False,
)


def timing_of(config: InstrumentConfig, profile: DelayProfile | None = None) -> InstrumentTiming:
    """What is known of the delays of an instrument.

    Args:
        config: Its file.
        profile: Delays of both devices, instead of those that the drivers tell. Of a driver that tells only some of its delays,
            those stay that are not in the profile; a transfer time that nobody tells is computed from the region of interest.

    Raises:
        ConfigError: There is no profile, and a driver does not tell all of its delays.
    """
    camera, actuator = _told(config.camera), _told(config.actuator)
    roi = config.roi.roi.shape if config.roi else None
    if profile is not None:
        sent = None if camera.complete else roi
        camera, actuator = camera.measured(profile), actuator.measured(profile)
        if sent is not None:
            camera = replace(camera, profile=with_transfer(camera.profile, sent, camera.packet_size))
    pairs = ((config.camera, camera, CAMERA_STREAMS), (config.actuator, actuator, ACTUATOR_STREAMS))
    problems = [_missing(device, told, streams) for device, told, streams in pairs if not told.complete]
    if problems:
        raise ConfigError(
            f"the delays of instrument {config.name} are not known:",
            problems,
            hint="measure them and give them with --delays PROFILE.json.",
        )
    return InstrumentTiming(camera, actuator, roi)


def storing_of(config: InstrumentConfig) -> DelayStreams | None:
    """What storing a line takes, of an instrument whose delays are simulated; None where it takes what it takes."""
    camera = _told(config.camera)
    return camera.streams if camera.complete and "T_store" in camera.profile.streams else None


def _told(device: DeviceConfig) -> DeviceTiming:
    backend = device.backend
    told = backend.timing(device.options) if backend.timing else _TELLS_NOTHING
    if not isinstance(told, DeviceTiming):
        raise TypeError(f"{device.role.word} driver {device.driver!r}: timing returned a {type(told).__name__}")
    return told


def _missing(device: DeviceConfig, told: DeviceTiming, streams: Sequence[str]) -> str:
    absent = ", ".join(name for name in streams if name not in told.profile.streams)
    return f"{device.role.word}.driver = {device.driver!r} does not tell {absent}"

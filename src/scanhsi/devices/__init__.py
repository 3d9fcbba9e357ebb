"""Contracts of the devices: what a driver promises and what the engine may rely on. One file a role."""

from scanhsi.devices.actuator import Actuator, ActuatorInfo, Motion
from scanhsi.devices.camera import Camera, CameraInfo, CameraSettings, Exposure, Roi, Trigger, check_settings
from scanhsi.devices.capabilities import (
    ForetellsEnd,
    FreeRunning,
    HardwareTriggered,
    MeasuresTemperature,
    OverlapsReadout,
    ShowsScenes,
    Sighting,
    Sweep,
    Sweeps,
    TellsStart,
    capabilities_of,
    require,
    sensor_temperature_c,
)
from scanhsi.devices.frames import Frame, FrameChannel, FrameEvent, FrameGap, FrameStream, Pixels
from scanhsi.devices.light import Light, LightInfo, Lit
from scanhsi.devices.pixels import PixelFormat, unpack
from scanhsi.devices.registry import Backend, Found, Role, find, installed
from scanhsi.devices.values import Range

__all__ = [
    "Actuator",
    "ActuatorInfo",
    "Backend",
    "Camera",
    "CameraInfo",
    "CameraSettings",
    "Exposure",
    "ForetellsEnd",
    "Found",
    "Frame",
    "FrameChannel",
    "FrameEvent",
    "FrameGap",
    "FrameStream",
    "FreeRunning",
    "HardwareTriggered",
    "Light",
    "LightInfo",
    "Lit",
    "MeasuresTemperature",
    "Motion",
    "OverlapsReadout",
    "PixelFormat",
    "Pixels",
    "Range",
    "Roi",
    "Role",
    "ShowsScenes",
    "Sighting",
    "Sweep",
    "Sweeps",
    "TellsStart",
    "Trigger",
    "capabilities_of",
    "check_settings",
    "find",
    "installed",
    "require",
    "sensor_temperature_c",
    "unpack",
]

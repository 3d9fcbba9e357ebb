"""The instrument: what a person configures, and the open devices it composes."""

from scanhsi.instrument.config import (
    Geometry,
    InstrumentConfig,
    Limits,
    RoiConfig,
    ScanDefaults,
    Spectral,
    Storage,
)
from scanhsi.instrument.device_config import ActuatorConfig, CameraConfig, DeviceConfig, LightConfig
from scanhsi.instrument.instrument import Instrument
from scanhsi.instrument.load import load_instrument, shipped, template

__all__ = [
    "ActuatorConfig",
    "CameraConfig",
    "DeviceConfig",
    "Geometry",
    "Instrument",
    "InstrumentConfig",
    "LightConfig",
    "Limits",
    "RoiConfig",
    "ScanDefaults",
    "Spectral",
    "Storage",
    "load_instrument",
    "shipped",
    "template",
]

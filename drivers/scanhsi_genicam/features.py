"""A camera's features as scanhsi knows them: what it is and allows, and applying settings. Blocking; one thread at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from scanhsi.devices.camera import CameraInfo, CameraSettings, Roi, Trigger
from scanhsi.devices.errors import OutOfRange, UnsupportedFeature
from scanhsi.devices.pixels import PixelFormat
from scanhsi.devices.values import Range
from scanhsi_genicam.options import GenicamOptions

if TYPE_CHECKING:
    from viva_genicam import Camera

_EXPOSURES = ("ExposureTime", "ExposureTimeAbs")  # microseconds; those in units of the device mean nothing to us
_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
TEMPERATURE = "DeviceTemperature"
_S_PER_US = 1e-6


def describe(camera: Camera, options: GenicamOptions, name: str) -> CameraInfo:
    """What the camera is and allows.

    Raises:
        UnsupportedFeature: It cannot be triggered by software, or sends no monochrome format that scanhsi knows.
    """
    words = {
        feature: _text(camera, feature) for feature in ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber")
    }
    exposure = _limits(camera, _first(camera, _EXPOSURES, name), name)
    known = set(camera.available_enum_entries("PixelFormat"))
    formats = tuple(pixel_format for pixel_format in PixelFormat if pixel_format.value in known)
    triggers = camera.available_enum_entries("TriggerSource") if _has(camera, "TriggerSource") else []
    if not formats or "Software" not in triggers:
        what = "no software trigger" if formats else f"none of the formats {', '.join(PixelFormat)}"
        raise UnsupportedFeature(f"the camera has {what}.", device=name, operation="connect")
    return CameraInfo(
        name=name,
        vendor=words["DeviceVendorName"],
        model=words["DeviceModelName"],
        serial=words["DeviceSerialNumber"],
        firmware=_text(camera, "DeviceFirmwareVersion"),
        bands=camera.get_integer("HeightMax"),
        samples=camera.get_integer("WidthMax"),
        pixel_formats=formats,
        exposure=Range(exposure.minimum * _S_PER_US, exposure.maximum * _S_PER_US, exposure.step * _S_PER_US, "s"),
        gain=_gain(camera, name),
        roi_step=(_step(camera, "Height", name), _step(camera, "Width", name)),
        triggers=frozenset({Trigger.SOFTWARE}),
        readout_s=options.readout_s or _shortest_period_s(camera, name),
        simulated=options.simulated or "fake" in words["DeviceModelName"].lower(),
    )


def apply(camera: Camera, settings: CameraSettings, info: CameraInfo) -> CameraSettings:
    """Apply settings that `info` allows; return them as the camera rounded them.

    Raises:
        OutOfRange: The region is smaller than the camera can read out; nothing was changed.
    """
    from viva_genicam import Roi as Region

    roi = settings.roi or Roi(0, 0, info.samples, info.bands)
    for feature, size in (("Width", roi.samples), ("Height", roi.bands)):
        smallest = _limits(camera, feature, info.name).minimum
        if size < smallest:
            raise OutOfRange(f"{feature} {size} px is below {smallest:g} px.", device=info.name, operation="configure")
    if _has(camera, "ExposureAuto"):
        camera.set_enum("ExposureAuto", "Off")
    if _has(camera, "GainAuto"):
        camera.set_enum("GainAuto", "Off")
    camera.disable_trigger("FrameStart")
    camera.set_acquisition_mode("Continuous")
    camera.set_roi(Region(roi.sample_offset, roi.band_offset, roi.samples, roi.bands))
    camera.set_enum("PixelFormat", settings.pixel_format.value)
    _run_fast(camera, info.name)
    exposure = _first(camera, _EXPOSURES, info.name)
    camera.set_float(exposure, settings.exposure_s / _S_PER_US)
    if info.gain.maximum > info.gain.minimum:
        camera.set_float("Gain", settings.gain_db)
    gain_db = camera.get_float("Gain") if info.gain.maximum > info.gain.minimum else 0.0
    return CameraSettings(camera.get_float(exposure) * _S_PER_US, gain_db, settings.pixel_format, roi)


def temperature_c(camera: Camera) -> float | None:
    """Temperature where ``DeviceTemperatureSelector`` points, degrees Celsius; None where the camera tells none."""
    if not _has(camera, TEMPERATURE):
        return None
    camera.invalidate(TEMPERATURE)  # whatever the camera's description says of caching
    celsius = camera.get_float(TEMPERATURE)
    return celsius if math.isfinite(celsius) else None


def tick_ns(camera: Camera) -> float:
    """Length of a tick of the camera's clock; 1 ns where it does not tell."""
    name = "GevTimestampTickFrequency"
    return 1e9 / (camera.get_integer(name) or 1e9) if _has(camera, name) else 1.0


def _has(camera: Camera, feature: str) -> bool:
    info = camera.node_info(feature)
    return info is not None and info.effective_access is not None


def _first(camera: Camera, features: tuple[str, ...], name: str) -> str:
    found = next((feature for feature in features if _has(camera, feature)), None)
    if found is None:
        raise UnsupportedFeature(f"the camera has none of {', '.join(features)}.", device=name, operation="connect")
    return found


def _text(camera: Camera, feature: str) -> str:
    return camera.get(feature) if _has(camera, feature) else ""


def _limits(camera: Camera, feature: str, name: str) -> Range:
    limits = camera.feature_state(feature).range
    if limits is None:
        raise UnsupportedFeature(f"the camera tells no limits of {feature}.", device=name, operation="connect")
    return Range(limits.min, limits.max, limits.inc or 0.0)


def _gain(camera: Camera, name: str) -> Range:
    """In dB; a camera that knows only raw gains keeps the one it has."""
    if not _has(camera, "Gain"):
        return Range(0.0, 0.0, unit="dB")
    gain = _limits(camera, "Gain", name)
    return Range(gain.minimum, gain.maximum, gain.step, "dB")


def _step(camera: Camera, feature: str, name: str) -> int:
    return max(1, round(_limits(camera, feature, name).step))


def _shortest_period_s(camera: Camera, name: str) -> float:
    rate = next((feature for feature in _RATES if _has(camera, feature)), None)
    return 1 / _limits(camera, rate, name).maximum if rate else 0.0


def _run_fast(camera: Camera, name: str) -> None:
    """Let no frame rate hold triggers back."""
    if rate := next((feature for feature in _RATES if _has(camera, feature)), None):
        camera.set_frame_rate(_limits(camera, rate, name).maximum)

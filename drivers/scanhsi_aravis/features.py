"""The GenICam features of an opened camera: names that differ by vendor, units, ranges and the order of writes.

Exposure is in us and gain in dB on the camera. ``GainRaw`` is taken as whole dB, which it is on Allied Vision's cameras.
"""

from __future__ import annotations

import math
import socket
from dataclasses import dataclass
from typing import Any

from scanhsi.devices.camera import CameraSettings, Roi, Trigger
from scanhsi.devices.errors import OutOfRange, ProtocolError, UnsupportedFeature
from scanhsi.devices.pixels import PixelFormat
from scanhsi.devices.values import Range

GVCP_PORT = 3956
JUMBO = 9000
_IP_MTU = 14  # getsockopt: the kernel's idea of the path's MTU; the socket module lacks the name


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with a unit under the names that vendors give it.

    Attributes:
        word: For messages.
        names: Features in order of preference.
        integer: Those of them that are integers.
        per_unit: Feature units in one of ours (1e6 us in a second).
        unit: Ours.
    """

    word: str
    names: tuple[str, ...]
    integer: frozenset[str]
    per_unit: float
    unit: str


EXPOSURE = Quantity("exposure", ("ExposureTime", "ExposureTimeAbs"), frozenset(), 1e6, "s")
GAIN = Quantity("gain", ("Gain", "GainRaw"), frozenset({"GainRaw"}), 1.0, "dB")
FRAME_RATE = Quantity("frame rate", ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"), frozenset(), 1.0, "Hz")
TEMPERATURE = "DeviceTemperature"


class Features:
    """Features of one camera. One thread only, as for all of Aravis but streams.

    The camera is in no local variable here: an error's traceback would keep it, and its heartbeat, alive after `forget`.

    Args:
        camera: An ``Aravis.Camera``.
    """

    def __init__(self, camera: Any) -> None:
        self._camera: Any = camera

    def forget(self) -> None:
        """Let go of the camera; nothing else may be called then."""
        self._camera = None

    def has(self, name: str) -> bool:
        """Whether the camera has the feature, and has it now."""
        return bool(self._camera.is_feature_available(name))

    def text(self, *names: str) -> str:
        """The first of these string features that the camera has, or ''."""
        return next((str(self._camera.get_string(name)) for name in names if self.has(name)), "")

    def entries(self, name: str) -> frozenset[str]:
        """The entries of an enumeration that can be chosen now."""
        return frozenset(self._camera.dup_available_enumerations_as_strings(name)) if self.has(name) else frozenset()

    def range(self, quantity: Quantity) -> Range:
        """What the camera allows now, in our unit."""
        name = self._name(quantity)
        if name in quantity.integer:
            bounds, step = self._camera.get_integer_bounds(name), self._camera.get_integer_increment(name)
        else:
            bounds, step = self._camera.get_float_bounds(name), 0.0
        low, high = (value / quantity.per_unit for value in bounds)
        return Range(low, high, step / quantity.per_unit, quantity.unit)

    def get(self, quantity: Quantity) -> float:
        """The value in force, in our unit."""
        name = self._name(quantity)
        raw = self._camera.get_integer(name) if name in quantity.integer else self._camera.get_float(name)
        return raw / quantity.per_unit

    def set(self, quantity: Quantity, value: float) -> float:
        """Set a value, in our unit; return it as applied."""
        name = self._name(quantity)
        raw = value * quantity.per_unit
        if name in quantity.integer:
            self._camera.set_integer(name, round(raw))
        else:
            low, high = self._camera.get_float_bounds(name)
            self._camera.set_float(name, _snapped(raw, low, high))
        return self.get(quantity)

    def temperature_c(self) -> float | None:
        """Temperature where ``DeviceTemperatureSelector`` points, degrees Celsius; None where the camera tells none."""
        if not self.has(TEMPERATURE):
            return None
        celsius = float(self._camera.get_float(TEMPERATURE))
        return celsius if math.isfinite(celsius) else None

    def choose(self, name: str, entry: str) -> None:
        """Choose an entry of an enumeration if the camera has that enumeration."""
        if self.has(name):
            self._camera.set_string(name, entry)

    def region_range(self) -> tuple[int, int, tuple[int, int]]:
        """(bands, samples) of the sensor, and the granularity of the region as (bands, samples)."""
        samples, bands = self._camera.get_sensor_size()
        band_step = max(self._camera.get_height_increment(), self._camera.get_y_offset_increment(), 1)
        sample_step = max(self._camera.get_width_increment(), self._camera.get_x_offset_increment(), 1)
        return bands, samples, (band_step, sample_step)

    def pixel_formats(self) -> tuple[PixelFormat, ...]:
        """Formats that both the camera and scanhsi know."""
        entries = self.entries("PixelFormat")
        return tuple(pixel_format for pixel_format in PixelFormat if pixel_format.value in entries)

    def triggers(self, line: str) -> frozenset[Trigger]:
        """What can start an exposure; ``line`` is the input for hardware triggers."""
        sources = self.entries("TriggerSource")
        found = {Trigger.FREE_RUN}
        if "Software" in sources:
            found.add(Trigger.SOFTWARE)
        if line in sources:
            found.add(Trigger.LINE)
        return frozenset(found)

    def apply(self, settings: CameraSettings, shortest_exposure_s: float) -> tuple[CameraSettings, float]:
        """Write checked settings, in the order in which each is allowed by those before it.

        Returns:
            The settings as applied, and the shortest time between frames (s) that the camera allows with them, not counting
            exposure: the highest frame rate depends on region, format, bandwidth and, on many cameras, exposure, so it is
            read while the exposure is the shortest.
        """
        roi = settings.roi
        assert roi is not None
        self.untrigger()
        self._camera.set_region(roi.sample_offset, roi.band_offset, roi.samples, roi.bands)
        self._camera.set_pixel_format_from_string(settings.pixel_format.value)
        self.choose("ExposureAuto", "Off")
        self.choose("GainAuto", "Off")
        self.set(EXPOSURE, shortest_exposure_s)
        readout_s = 1 / self.range(FRAME_RATE).maximum if self._find(FRAME_RATE) else 0.0
        exposure_s, gain_db = self.set(EXPOSURE, settings.exposure_s), self.set(GAIN, settings.gain_db)
        x, y, width, height = self._camera.get_region()
        applied = CameraSettings(
            exposure_s, gain_db, PixelFormat(self._camera.get_pixel_format_as_string()), Roi(x, y, width, height)
        )
        return applied, readout_s

    def untrigger(self) -> None:
        """Exposures on the camera's own clock: every trigger off."""
        self._camera.clear_triggers()
        self.choose("AcquisitionMode", "Continuous")

    def trigger(self, source: str) -> None:
        """One exposure each time ``source`` fires. The last write before acquisition starts."""
        if self.has("AcquisitionFrameRateEnable"):
            self._camera.set_boolean("AcquisitionFrameRateEnable", False)  # else it would limit the triggers too
        self.choose("TriggerSelector", "FrameStart")
        self._camera.set_string("TriggerSource", source)
        self.choose("TriggerActivation", "RisingEdge")
        self._camera.set_string("TriggerMode", "On")

    def set_frame_period(self, period_s: float) -> float:
        """Time between exposures on the camera's own clock, s; returns it as applied."""
        if self.has("AcquisitionFrameRateEnable"):
            self._camera.set_boolean("AcquisitionFrameRateEnable", True)
        return 1 / self.set(FRAME_RATE, 1 / period_s)

    def set_bandwidth(self, bytes_per_second: int) -> None:
        """Limit the rate at which the camera sends, bytes/s."""
        if not self.has("StreamBytesPerSecond"):
            raise UnsupportedFeature("the camera has no StreamBytesPerSecond; leave the option out.")
        self._camera.set_integer("StreamBytesPerSecond", bytes_per_second)

    def set_packet_size(self, asked: int | None, address: str) -> int:
        """Set the size of stream packets and read it back. Aravis' automatic choice is not used: it can exceed the MTU.

        Args:
            asked: Size that must be used, or None for what the network interface takes.
            address: IP address of the camera.

        Raises:
            OutOfRange: The interface or the camera does not take the size.
            ProtocolError: The camera takes it and uses another.
        """
        mtu = path_mtu(address)
        low, high = self._camera.get_integer_bounds("GevSCPSPacketSize")
        size = min(mtu, JUMBO, high) // 4 * 4 if asked is None else asked
        if not low <= size <= min(mtu, high):
            raise OutOfRange(
                f"packet size {size} is not allowed; the camera takes {low} to {high} bytes, the network interface {mtu}.",
                hint="set the interface's MTU to the size, or leave packet_size out.",
            )
        self._camera.gv_set_packet_size(size)
        applied = int(self._camera.gv_get_packet_size())
        if applied > mtu or (asked is not None and applied != asked):
            raise ProtocolError(f"the camera uses packets of {applied} bytes when told {size}.")
        return applied

    def _find(self, quantity: Quantity) -> str | None:
        return next((name for name in quantity.names if self.has(name)), None)

    def _name(self, quantity: Quantity) -> str:
        name = self._find(quantity)
        if name is None:
            raise UnsupportedFeature(f"the camera has no {quantity.word} feature ({' or '.join(quantity.names)}).")
        return name


def _snapped(raw: float, low: float, high: float) -> float:
    """``raw``, but on a limit that it misses only by rounding: 21e-6 s are a hair less than 21 us, and would be refused."""
    for limit in (low, high):
        if math.isclose(raw, limit, rel_tol=1e-6):
            return limit
    return raw


def path_mtu(address: str) -> int:
    """Largest IP packet that the interface towards ``address`` takes, in bytes. Sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, GVCP_PORT))
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)

"""The camera contract.

A camera driver is any class with these methods; it need not inherit from anything. Calls come from one event loop, one at a
time except where stated, in this order::

    connect ──> configure ──> arm ──> expose* / frames ──> disarm ──> close
                    ^                                         │
                    └─────────────────────────────────────────┘

* **Time.** Stamps are integers in ns on the clock of the running loop (`scanhsi.clock.now_ns`). A driver sleeps through asyncio
  and runs what blocks in a thread, so that the same scan runs in virtual time.
* **Refusals.** A setting outside what ``info`` allows raises `OutOfRange` and changes nothing. Nothing is clamped in silence: a
  camera that rounds (exposure to its time base) returns what it applied.
* **Frames.** Every exposure ends as exactly one `Frame` or in exactly one `FrameGap`, in order of ``index``.
* **Failure.** Anything that goes wrong is a `DeviceError` raised ``from`` its cause. After `DeviceLost` the object is only good for
  ``close()``; after that ``connect`` opens the camera anew, with nothing of its settings left.
* **Cancellation.** Every method may be cancelled at any await; afterwards ``disarm`` and ``close`` must still work.
* **Idempotence.** ``disarm`` and ``close`` may be called in any state and any number of times; after ``close`` no thread, socket
  or buffer of the driver is left, except memory that a consumer still views.

Optional abilities are protocols of their own in `scanhsi.devices.capabilities`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum, unique
from typing import Protocol, runtime_checkable

from scanhsi.devices.errors import OutOfRange
from scanhsi.devices.frames import Frame, FrameStream, Pixels
from scanhsi.devices.pixels import PixelFormat
from scanhsi.devices.values import Range


@unique
class Trigger(StrEnum):
    """What starts an exposure."""

    SOFTWARE = "software"
    """`Camera.expose`."""
    LINE = "line"
    """An electrical pulse, e.g. one each n-th step of the mirror; see `HardwareTriggered`."""
    FREE_RUN = "free-run"
    """The camera's own clock; see `FreeRunning`."""


@dataclass(frozen=True, slots=True)
class Roi:
    """Region of the sensor that is read out, in pixels. Samples run along the slit, bands along the spectrum."""

    sample_offset: int
    band_offset: int
    samples: int
    bands: int

    @property
    def shape(self) -> tuple[int, int]:
        """(bands, samples)."""
        return self.bands, self.samples


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What ``configure`` asks for, and what it answers as applied.

    Attributes:
        exposure_s: Exposure time of a frame.
        gain_db: Analogue gain.
        pixel_format: Format on the link.
        roi: Region read out; None asks for the whole sensor and is never in an answer.
    """

    exposure_s: float
    gain_db: float = 0.0
    pixel_format: PixelFormat = PixelFormat.MONO12_PACKED
    roi: Roi | None = None


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """What a connected camera is and allows.

    Attributes:
        name: How messages call it, with its address (``"camera aravis 192.168.1.20"``).
        vendor, model, serial, firmware: As the camera tells.
        bands, samples: Shape of the sensor.
        pixel_formats: Formats it can send.
        exposure, gain: Allowed exposure times (s) and gains (dB).
        roi_step: (bands, samples): granularity of ROI size and offset.
        triggers: What can start an exposure.
        readout_s: Time to read the whole sensor out; 1 / frame rate limit.
        simulated: True for anything that is not a real camera on a real bench. Stored in the cube, loudly.
    """

    name: str
    vendor: str
    model: str
    serial: str
    firmware: str
    bands: int
    samples: int
    pixel_formats: tuple[PixelFormat, ...]
    exposure: Range
    gain: Range
    roi_step: tuple[int, int] = (1, 1)
    triggers: frozenset[Trigger] = frozenset({Trigger.SOFTWARE})
    readout_s: float = 0.0
    simulated: bool = False


@dataclass(frozen=True, slots=True)
class Exposure:
    """One finished exposure of `Camera.expose`; loop clock, ns.

    Attributes:
        index: Exposures since ``arm()``, from 0: the ``index`` of the frame it makes.
        trigger_ns: When the trigger was sent.
        start_ns: Start of exposure, as well as the driver knows it.
        end_ns: End of exposure. Where ``timed`` is true it is an upper bound: trigger + exposure + margin.
        timed: True when no event of the camera told the end.
    """

    index: int
    trigger_ns: int
    start_ns: int
    end_ns: int
    timed: bool


@runtime_checkable
class Camera(Protocol):
    """The camera contract; see the module docstring for the rules that hold for every method."""

    @property
    def info(self) -> CameraInfo:
        """What the camera is and allows. Known after ``connect``; raises `DeviceError` before."""
        ...

    async def connect(self) -> None:
        """Open the camera and take control of it.

        Raises:
            DeviceNotFound: Nothing answers there.
            DeviceBusy: Somebody else controls it.
            DeviceUnavailable: A library is missing.
        """
        ...

    async def close(self) -> None:
        """Disarm, give up control, free everything. Never raises for a camera that is gone."""
        ...

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings to a camera that is not armed; return them as applied (ROI filled in).

        Raises:
            OutOfRange: A value is not allowed (use `check_settings`); nothing was changed.
        """
        ...

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Make ready to expose: allocate ``buffers`` frame buffers, start the stream, count frames from 0.

        Raises:
            UnsupportedFeature: The camera cannot be triggered so.
        """
        ...

    async def expose(self) -> Exposure:
        """Trigger one exposure by software; return at the *end of exposure*, when the mirror may move.

        Does not wait for the frame: that comes through ``frames()``, perhaps after the next exposure has begun. Where the
        sensor is still busy with the last frame the trigger waits until it may be sent. One call at a time.
        When cancelled, an exposure that was triggered goes on by itself; its frame still counts.
        """
        ...

    def frames(self) -> FrameStream:
        """The frames and gaps since ``arm()``. One consumer; may run beside ``expose``."""
        ...

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """Copy a frame's pixels into ``out``, unpacked; may run beside ``expose`` and ``frames``.

        Args:
            frame: A frame of this camera.
            out: (bands, samples), C-contiguous, of ``frame.pixel_format.dtype``; None when nobody wants the pixels (the
                line is discarded): then only the time it would have cost is spent, where a simulated camera models it.
        """
        ...

    async def disarm(self) -> None:
        """Stop exposing. Frames already received stay readable, then ``frames()`` ends."""
        ...


def check_settings(info: CameraInfo, settings: CameraSettings) -> CameraSettings:
    """Refuse settings that ``info`` does not allow; return them with the ROI filled in.

    Raises:
        OutOfRange: The message lists every value that is not allowed, with what is.
    """
    roi = settings.roi or Roi(0, 0, info.samples, info.bands)
    problems: list[str] = []
    for name, value, allowed in (
        ("exposure", settings.exposure_s, info.exposure),
        ("gain", settings.gain_db, info.gain),
        ("ROI samples", roi.samples, Range(info.roi_step[1], info.samples, info.roi_step[1], "px")),
        ("ROI bands", roi.bands, Range(info.roi_step[0], info.bands, info.roi_step[0], "px")),
        (
            "ROI sample offset",
            roi.sample_offset,
            Range(0, info.samples - roi.samples, info.roi_step[1], "px"),
        ),
        ("ROI band offset", roi.band_offset, Range(0, info.bands - roi.bands, info.roi_step[0], "px")),
    ):
        if value not in allowed:
            unit = f" {allowed.unit}" if allowed.unit else ""
            problems.append(f"{name} {value:g}{unit} is not allowed; allowed is {allowed}.")
    if settings.pixel_format not in info.pixel_formats:
        known = ", ".join(info.pixel_formats)
        problems.append(f"pixel format {settings.pixel_format} is not allowed; allowed are {known}.")
    if problems:
        raise OutOfRange(" ".join(problems), device=info.name, operation="configure")
    return replace(settings, roi=roi)

"""The delays of an instrument as far as its drivers tell them before anything is connected."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from scanhsi.devices import PixelFormat
from scanhsi.timing.bounds import LineDelays, Ns
from scanhsi.timing.closed_forms import Layout
from scanhsi.timing.delays import DelayProfile, DelayStreams, Stream, StreamModel
from scanhsi.timing.distributions import Constant
from scanhsi.timing.link import transfer_s, wire_overhead
from scanhsi.timing.model import Terms
from scanhsi.timing.replay import BLOCK_LINES, delay_streams

CAMERA_STREAMS: Final[tuple[Stream, ...]] = (
    "T_rx",
    "T_api",
    "T_mcpy",
    "T_trig",
    "T_ev",
    "T_rd",
    "T_dead",
    "t1",
    "T_store",
)
ACTUATOR_STREAMS: Final[tuple[Stream, ...]] = ("T_act", "settle", "T_rand")
_FORMATS: Final = (PixelFormat.MONO8, PixelFormat.MONO12_PACKED, PixelFormat.MONO12)
_BY_SIZE: Final = ("T_rx", "T_mcpy")


@dataclass(frozen=True)
class DeviceTiming:
    """What one driver tells of its delays, made from its options by `scanhsi.devices.Backend.timing`.

    Attributes:
        profile: Its delays.
        seed: From which they are drawn.
        sensor: (bands, samples) of the frame that transfer and copy of the profile are for; None when they are for what is sent.
        whole_transfer: The whole sensor is sent, whatever region is kept.
        overlap: Whether the sensor exposes while it reads the last frame out.
        complete: These are all of its delays; a stream that is not in the profile takes no time. A real device is measured instead.
        packet_size: Of stream packets, in bytes, for a transfer time that is computed.
        block_lines: Mean length of a block where a recorded profile is replayed, `scanhsi.timing.replay.delay_streams`.
    """

    profile: DelayProfile
    seed: int = 0
    sensor: tuple[int, int] | None = None
    whole_transfer: bool = False
    overlap: bool = True
    complete: bool = True
    packet_size: int = 1500
    block_lines: int = BLOCK_LINES

    @cached_property
    def streams(self) -> DelayStreams:
        """The delays of each line."""
        return delay_streams(self.profile, self.seed, self.block_lines)

    def measured(self, profile: DelayProfile) -> DeviceTiming:
        """The same device with measured delays; where the driver knows only some, those not measured stay.

        A transfer that was recorded is that of the frames as they were sent, not of a whole sensor.
        """
        kept = {} if self.complete else self.profile.streams
        merged = profile.model_copy(update={"streams": {**kept, **profile.streams}})
        as_sent = self.whole_transfer or bool(profile.scans)
        return replace(self, profile=merged, complete=True, whole_transfer=as_sent)

    def part(self, pixel_format: PixelFormat, roi: tuple[int, int] | None) -> tuple[int, int]:
        """Bytes sent of a frame, and bytes of the frame that the profile is for."""
        if self.sensor is None or roi is None or self.whole_transfer:
            return 1, 1
        return pixel_format.payload_bytes(roi), pixel_format.payload_bytes(self.sensor)


@dataclass(frozen=True, slots=True)
class InstrumentTiming:
    """What both drivers tell.

    Attributes:
        camera, actuator: The drivers' delays.
        roi: (bands, samples) that are kept; None for the whole sensor.
        layout: Buffers; whether the sensor overlaps is the camera's to say.
    """

    camera: DeviceTiming
    actuator: DeviceTiming
    roi: tuple[int, int] | None = None
    buffers: Layout = field(default_factory=Layout)

    @property
    def layout(self) -> Layout:
        """What is not a delay."""
        return replace(self.buffers, overlap=self.camera.overlap)

    @property
    def formats(self) -> tuple[PixelFormat, ...]:
        """Pixel formats of which all delays are known."""
        divided = [model.by_format for model in self.camera.profile.streams.values() if model.by_format]
        return tuple(kind for kind in _FORMATS if all(kind in by_format for by_format in divided))

    @property
    def absent(self) -> tuple[Stream, ...]:
        """Streams that are in no profile and count as 0."""
        pairs = ((self.camera, CAMERA_STREAMS), (self.actuator, ACTUATOR_STREAMS))
        return tuple(name for device, names in pairs for name in names if name not in device.profile.streams)

    @property
    def marks(self) -> tuple[str, ...]:
        """How far to trust the numbers, as the profiles say."""
        return tuple(dict.fromkeys((self.camera.profile.mark, self.actuator.profile.mark)))

    def terms(self, exposure_s: float, pixel_format: PixelFormat, steps: int) -> Terms:
        """Mean delays of a line."""
        sent, whole = self.camera.part(pixel_format, self.roi)

        def mean_s(device: DeviceTiming, stream: Stream) -> float:
            mean = device.profile.mean_s(stream, pixel_format=pixel_format, steps=steps)
            return mean * sent / whole if stream in _BY_SIZE else mean

        camera = {f"{name}_s": mean_s(self.camera, name) for name in CAMERA_STREAMS}
        actuator = {f"{name}_s": mean_s(self.actuator, name) for name in ACTUATOR_STREAMS}
        return Terms(T_exp_s=exposure_s, **camera, **actuator)

    def delays(self, lines: int, exposure_s: float, pixel_format: PixelFormat, steps: int) -> LineDelays:
        """Drawn delays of the first lines, those that the simulated devices meet. The read-out is taken at its mean."""
        sent, whole = self.camera.part(pixel_format, self.roi)

        def column(device: DeviceTiming, *names: Stream) -> Ns:
            total = np.zeros(lines, np.int64)
            for name in names:
                drawn = device.streams.array_ns(name, lines, pixel_format=pixel_format, steps=steps)
                total += drawn * sent // whole if name in _BY_SIZE else drawn
            return total

        def mean_ns(stream: Stream) -> int:
            return round(self.camera.profile.mean_s(stream, pixel_format=pixel_format) * 1e9)

        return LineDelays(
            exposure=np.full(lines, round(exposure_s * 1e9), np.int64),
            actuate=column(self.actuator, "T_rand", "T_act", "settle"),
            trigger=column(self.camera, "T_trig"),
            transfer=column(self.camera, "T_rx", "T_api"),
            copy=column(self.camera, "T_mcpy"),
            store=column(self.camera, "T_store"),
            readout_ns=mean_ns("T_rd"),
            dead_ns=mean_ns("T_dead"),
            overlap=self.layout.overlap,
            buffers=self.layout.buffers,
            event=column(self.camera, "T_ev"),
            first_row_ns=mean_ns("t1"),
            whole_frame=not self.camera.profile.scans,  # a recorded transfer ended with the frame whole
            line_buffers=self.layout.line_buffers,
        )


def with_transfer(profile: DelayProfile, sent: tuple[int, int], packet_size: int) -> DelayProfile:
    """The profile with T_rx computed by Eq. 2 for Gigabit Ethernet, where it has none.

    Args:
        profile: Of a camera.
        sent: (bands, samples) on the wire.
        packet_size: Of stream packets, in bytes.
    """
    if "T_rx" in profile.streams:
        return profile
    overhead = wire_overhead(packet_size)
    model = StreamModel(
        note=f"Eq. 2 for {sent[0]} x {sent[1]} pixels over Gigabit Ethernet with packets of {packet_size} bytes.",
        mark="computed, not measured",
        by_format={
            kind: Constant(kind="constant", unit="s", value=transfer_s(sent, kind, overhead=overhead))
            for kind in _FORMATS
        },
    )
    return profile.model_copy(update={"streams": {**profile.streams, "T_rx": model}})

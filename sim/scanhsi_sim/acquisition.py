"""The time of an armed camera, from trigger to frame: sensor, link and buffers.

With S start and E end of exposure, R end of read-out and X reception of frame k:

* ``E_k = S_k + T_exp`` and ``R_k = E_k + T_rd``.
* The next exposure: ``S_k >= R_(k-1)``, or where it may overlap read-out ``S_k >= max(E_(k-1) + T_dead, R_(k-1) - T_exp)``.
* The link carries one frame at a time, while the sensor is still being read out:
  ``X_k = max(max(E_k + t1, X_(k-1)) + T_rx + T_api, R_k)``.
* Before the link is the camera's own memory; a frame that is exposed while it is full is lost.
* A frame needs a free buffer when its transfer begins, else it is lost, as on a real stream.

All times are integers in ns and follow from each other, not from when the event loop came round to looking: in real time a late
wake-up delays one frame and not the next.
"""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices import CameraSettings, Frame, FrameChannel, FrameGap, Roi
from scanhsi.timing.delays import DelayStreams, Stream
from scanhsi_sim.bench import Bench
from scanhsi_sim.scenes import Image

MEMORY_FRAMES = 16
"""Frames in the camera's own memory. An assumption, no particular camera's data sheet."""


@dataclass(eq=False)
class SimulatedFrame(Frame):
    """A frame that knows what to render once somebody asks for its pixels.

    Attributes:
        steps: Lowest and highest step of the motor during the exposure.
        view: Lowest and highest place that the mirror looked at, in steps.
        time_s: Middle of the exposure, since the camera connected.
        acquisition: How many times the camera was armed since it connected.
        scene: What the camera looks at.
        settings: Of the camera at the time, ROI filled in.
        pixels: The rendering under way or done, if it was asked for.
    """

    steps: tuple[int, int] = (0, 0)
    view: tuple[float, float] = (0.0, 0.0)
    time_s: float = 0.0
    acquisition: int = 0
    scene: str = ""
    settings: CameraSettings = field(default_factory=lambda: CameraSettings(0.0))
    pixels: asyncio.Future[Image] | None = None


class LineDelays:
    """Delays of lines, for the settings of the camera.

    A profile's transfer and copy are those of a whole frame: a smaller region takes its share of the bytes. Its read-out is not
    shorter: that depends on the sensor rows only, and the bounds of a scan count with the whole sensor.
    """

    def __init__(self, streams: DelayStreams, settings: CameraSettings, sent: Roi, sensor: Roi) -> None:
        self._streams = streams
        self._format = settings.pixel_format
        self._part = self._format.payload_bytes(sent.shape)
        self._whole = self._format.payload_bytes(sensor.shape)

    def ns(self, stream: Stream, line: int) -> int:
        """Delay of one line in ns."""
        delay = self._streams.delay_ns(stream, line, pixel_format=self._format)
        return delay * self._part // self._whole if stream in ("T_rx", "T_mcpy") else delay

    def received_ns(self, sent_ns: int, read_ns: int) -> int:
        """When a frame is received that has passed the link at ``sent_ns``: not before it is read out, as recorded ones were."""
        return sent_ns if self._streams.profile.scans else max(sent_ns, read_ns)

    def mean_s(self, stream: Stream) -> float:
        """Mean delay in s."""
        mean = self._streams.profile.mean_s(stream, pixel_format=self._format)
        return mean * self._part / self._whole if stream in ("T_rx", "T_mcpy") else mean


@dataclass(frozen=True, slots=True)
class Shot:
    """One exposure."""

    index: int
    start_ns: int
    end_ns: int
    read_ns: int


@dataclass(slots=True)
class _Buffers:
    """Free frame buffers in the host's memory.

    Frames give theirs back here and not to the acquisition: it holds the frames that nobody took, and whom a frame will tell of its
    end lives as long as the frame.
    """

    free: int

    def take(self) -> bool:
        """Whether there was one."""
        if not self.free:
            return False
        self.free -= 1
        return True

    def give_back(self) -> None:
        self.free += 1


class Acquisition:
    """One armed period of the camera."""

    def __init__(
        self,
        bench: Bench,
        delays: LineDelays,
        settings: CameraSettings,
        *,
        overlap: bool,
        buffers: int,
        epoch_ns: int,
        on_exposed: Callable[[SimulatedFrame], None],
    ) -> None:
        """An acquisition that begins now.

        Args:
            bench: Where the mirror is and the exposures are counted.
            delays: Of the lines.
            settings: Of the camera, ROI filled in.
            overlap: Whether an exposure may overlap the last read-out.
            buffers: Frames that may be in the host's memory.
            epoch_ns: Zero of the camera's own clock.
            on_exposed: Called with each frame as its transfer begins.
        """
        self.frames = FrameChannel()
        self.delays = delays
        self.active = True
        self._bench = bench
        self._settings = settings
        self._exposure_ns = round(settings.exposure_s * 1e9)
        self._overlap = overlap
        self._buffers = _Buffers(buffers)
        self._epoch_ns = epoch_ns
        self._on_exposed = on_exposed
        self._last: Shot | None = None
        self._next = 0
        self._waiting: asyncio.Queue[Shot | FrameGap] = asyncio.Queue()
        self._reported = 0
        self._received_ns = 0
        self._held = 0

    @property
    def index(self) -> int:
        """Index of the next exposure."""
        return self._next

    def earliest_ns(self) -> int:
        """Earliest start of the next exposure."""
        last = self._last
        if last is None:
            return 0
        if not self._overlap:
            return last.read_ns
        return max(last.end_ns + self.delays.ns("T_dead", last.index), last.read_ns - self._exposure_ns)

    def expose_at(self, start_ns: int) -> Shot:
        """Start an exposure, which goes on by itself from here."""
        end_ns = start_ns + self._exposure_ns
        shot = Shot(self._take_index(), start_ns, end_ns, end_ns + self.delays.ns("T_rd", self._next - 1))
        self._last = shot
        if self._held == MEMORY_FRAMES:
            self._waiting.put_nowait(
                FrameGap(shot.index, 1, "exposed faster than the link carries: the camera's memory is full")
            )
        else:
            self._held += 1
            self._waiting.put_nowait(shot)
        return shot

    def pulse(self, when_ns: int) -> None:
        """A pulse on the trigger line: expose, or lose the frame when the sensor is busy."""
        if when_ns >= self.earliest_ns():
            self.expose_at(when_ns)
        else:
            self._waiting.put_nowait(FrameGap(self._take_index(), 1, "trigger came while the sensor was busy"))

    def _take_index(self) -> int:
        self._next += 1
        self._bench.exposures = self._next
        return self._next - 1

    async def run_free(self, period_ns: int) -> None:
        """Expose on the camera's own clock, until cancelled."""
        start_ns = now_ns()
        while True:
            await sleep_until_ns(start_ns)
            self.expose_at(start_ns)
            start_ns += period_ns

    async def transfer(self) -> None:
        """Bring frames over the link, in order, until cancelled."""
        try:
            while True:
                item = await self._waiting.get()
                event = item if isinstance(item, FrameGap) else await self._carry(item)
                self._reported += 1
                self.frames.put(event)
                del event  # whoever takes the frame alone decides how long its buffer is in use
        except Exception as error:
            self.frames.fail(error)

    async def _carry(self, shot: Shot) -> Frame | FrameGap:
        first_byte_ns = max(shot.end_ns + self.delays.ns("t1", shot.index), self._received_ns)
        on_link_ns = self.delays.ns("T_rx", shot.index) + self.delays.ns("T_api", shot.index)
        self._received_ns = self.delays.received_ns(first_byte_ns + on_link_ns, shot.read_ns)
        await sleep_until_ns(first_byte_ns)
        if not self._buffers.take():
            await sleep_until_ns(self._received_ns)
            self._held -= 1
            return FrameGap(shot.index, 1, "no free buffer")
        frame = self._frame(shot, first_byte_ns)
        await sleep_until_ns(self._received_ns)
        self._held -= 1
        frame.received_ns = now_ns()
        return frame

    def _frame(self, shot: Shot, first_byte_ns: int) -> SimulatedFrame:
        roi = self._settings.roi
        assert roi is not None
        frame = SimulatedFrame(
            index=shot.index,
            frame_id=shot.index % 0xFFFF + 1,  # as GigE Vision counts: 16 bits, never 0
            payload=None,
            pixel_format=self._settings.pixel_format,
            shape=roi.shape,
            received_ns=0,
            device_ns=shot.start_ns - self._epoch_ns,
            first_byte_ns=first_byte_ns,
            exposure_start_ns=shot.start_ns,
            steps=self._bench.mirror.span(shot.start_ns, shot.end_ns),
            view=self._bench.mirror.view(shot.start_ns, shot.end_ns),
            time_s=((shot.start_ns + shot.end_ns) / 2 - self._epoch_ns) * 1e-9,
            settings=self._settings,
        )
        weakref.finalize(frame, self._buffers.give_back).atexit = False
        self._on_exposed(frame)
        return frame

    def end(self) -> None:
        """Disarmed: what has not arrived is reported lost, and the frames end. Idempotent."""
        if not self.active:
            return
        self.active = False
        if self._next > self._reported:
            count = self._next - self._reported
            self.frames.put(FrameGap(self._reported, count, "the camera was disarmed before the frame arrived"))
        self.frames.close()

"""The simulated camera: real pixels of a simulated scene, at times drawn from a delay profile."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from functools import lru_cache
from threading import Lock
from typing import TypeVar

import numpy as np

from scanhsi.clock import is_virtual, now_ns, run_blocking, sleep_until_ns
from scanhsi.devices import (
    CameraInfo,
    CameraSettings,
    Exposure,
    Frame,
    FrameStream,
    PixelFormat,
    Pixels,
    Range,
    Roi,
    Trigger,
    check_settings,
)
from scanhsi.devices.errors import DeviceBusy, DeviceError, OutOfRange
from scanhsi.timing.buffers import levelled_period_s, long_run_spread_s
from scanhsi.timing.delays import DelayStreams
from scanhsi.timing.replay import delay_streams
from scanhsi_sim.acquisition import MEMORY_FRAMES, Acquisition, LineDelays, SimulatedFrame
from scanhsi_sim.bench import bench
from scanhsi_sim.effects import Setup
from scanhsi_sim.options import CameraOptions, find_profile, sends_whole
from scanhsi_sim.scenes import COLD_LAMP, SCENES, Image, Scene, load_scene

T = TypeVar("T")

_FORMATS = (PixelFormat.MONO8, PixelFormat.MONO12_PACKED, PixelFormat.MONO12)
_LEVELLING = MEMORY_FRAMES // 2  # frames of the camera's memory that level the link out; the rest is for the unforeseen
_SURVEYED = 4096
_SURVEY_SEED = 2**62  # the link is known as one who has measured it knows it, not from the delays to come

_building = Lock()


@lru_cache(maxsize=4)
def _scene_of(name: str, setup: Setup) -> Scene:
    return load_scene(name, setup=setup)


class SimulatedCamera:
    """A camera whose exposures do not overlap read-out; see `OverlappingCamera`. Obeys the camera contract.

    It renders only what is asked for: `unpack` without a buffer costs its time and nothing else. In real time, once pixels were
    asked for, the next frames are rendered while they are "in transfer", so that rendering costs no time of the scan's.
    """

    _overlap = False

    def __init__(self, options: CameraOptions) -> None:
        self._options = options
        self._bench = bench(options.bench)
        self._profile = find_profile(options.profile)
        self._streams = delay_streams(self._profile, options.seed, options.block_lines)
        self._name = f"camera simulated {options.bench}"
        self._info: CameraInfo | None = None
        self._epoch_ns = 0
        self._settings: CameraSettings | None = None
        self._period_ns: int | None = None
        self._run: Acquisition | None = None
        self._trigger = Trigger.SOFTWARE
        self._tasks: list[asyncio.Task[None]] = []
        self._ahead = False
        self._armed, self._shown_s = 0, 0.0

    @property
    def info(self) -> CameraInfo:
        """What the camera is and allows."""
        if self._info is None:
            raise self._error("it is not connected.", "info")
        return self._info

    async def connect(self) -> None:
        """Take the camera's place on the bench. In real time the scene is made now, which can take seconds."""
        self._bench.claim("camera", self, self._name)
        options = self._options
        self._epoch_ns = now_ns()
        self._armed, self._shown_s = 0, 0.0
        self._info = CameraInfo(
            name=self._name,
            vendor="scanhsi",
            model="simulated camera",
            serial=f"seed {options.seed}",
            firmware=f"delay profile {self._profile.name} ({self._profile.mark})",
            bands=options.bands,
            samples=options.samples,
            pixel_formats=_FORMATS,
            exposure=Range(*options.exposure_range_s, unit="s"),
            gain=Range(*options.gain_range_db, unit="dB"),
            triggers=frozenset(Trigger),
            readout_s=self._profile.mean_s("T_rd"),
            simulated=True,
        )
        if not is_virtual():
            await run_blocking(0.0, self._load, self._options.scene)

    async def close(self) -> None:
        """Disarm and leave the bench."""
        try:
            await self.disarm()
        finally:
            self._info = self._settings = self._period_ns = None
            self._bench.release("camera", self)

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; the exposure is rounded to whole ns."""
        applied = check_settings(self.info, settings)
        if self._run is not None:
            raise DeviceBusy("it is armed.", device=self._name, operation="configure", hint="disarm it first.")
        if applied.pixel_format not in self._timed_formats():
            raise self._error(f"profile {self._profile.name} has no delays for {applied.pixel_format}.", "configure")
        self._settings = applied
        self._period_ns = None
        return applied

    def _timed_formats(self) -> tuple[PixelFormat, ...]:
        streams = [model.by_format for model in self._profile.streams.values() if model.by_format]
        return tuple(kind for kind in _FORMATS if all(kind in stream for stream in streams))

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Count frames from 0; in free run the exposures begin now."""
        settings = self._configured("arm")
        if self._run is not None:
            raise DeviceBusy("it is armed already.", device=self._name, operation="arm", hint="disarm it first.")
        if buffers < 1:
            raise ValueError(f"buffers must be at least 1, not {buffers}")
        run = Acquisition(
            self._bench,
            self._delays(),
            settings,
            overlap=self._overlap,
            buffers=buffers,
            epoch_ns=self._epoch_ns,
            on_exposed=self._exposed,
        )
        self._run, self._trigger, self._ahead = run, trigger, False
        self._armed += 1
        self._bench.exposures = 0
        self._bench.pixel_format = settings.pixel_format
        self._tasks = [asyncio.create_task(run.transfer(), name="simulated link")]
        if trigger is Trigger.LINE:
            self._bench.trigger = run.pulse
        if trigger is Trigger.FREE_RUN:
            period_ns = self._period_ns or round(self._shortest_period_s() * 1e9)
            self._tasks.append(asyncio.create_task(run.run_free(period_ns), name="simulated frame clock"))

    async def expose(self) -> Exposure:
        """Trigger one exposure and return at its end."""
        return await self.expose_foretold(lambda end_ns: None)

    async def expose_foretold(self, foretold: Callable[[int], None]) -> Exposure:
        """Trigger one exposure, tell when it will end, and return then."""
        run = self._run
        if run is None or self._trigger is not Trigger.SOFTWARE:
            raise self._error("it is not armed for software triggers.", "expose")
        delays = run.delays
        delay_ns = delays.ns("T_trig", run.index)
        allowed_ns = run.earliest_ns() - delay_ns
        if allowed_ns > now_ns():
            await sleep_until_ns(allowed_ns)
            if not run.active:
                raise self._error("it was disarmed while the trigger waited for the sensor.", "expose")
        trigger_ns = now_ns()
        shot = run.expose_at(trigger_ns + delay_ns)
        foretold(shot.end_ns)
        await sleep_until_ns(shot.end_ns + delays.ns("T_ev", shot.index))
        return Exposure(shot.index, trigger_ns, shot.start_ns, shot.end_ns, timed=False)

    def frames(self) -> FrameStream:
        """The frames and gaps since `arm`."""
        if self._run is None:
            raise self._error("it is not armed.", "frames")
        return self._run.frames

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """Render a frame into `out`, or only spend the time that copying it would cost."""
        if not isinstance(frame, SimulatedFrame):
            raise TypeError(f"{self._name} can only unpack its own frames, not a {type(frame).__name__}")
        began_ns = now_ns()
        cost_ns = self._delays(frame.settings).ns("T_mcpy", frame.index)
        if out is not None:
            if (
                out.shape != frame.shape
                or out.dtype != np.dtype(frame.pixel_format.dtype)
                or not out.flags.c_contiguous
            ):
                wanted = f"C-contiguous {np.dtype(frame.pixel_format.dtype)} {frame.shape}"
                raise ValueError(f"unpack of a {frame.pixel_format} frame needs {wanted}, not {out.dtype} {out.shape}")
            self._ahead = not is_virtual()
            if frame.pixels is None:
                # Not cancellable: the thread writes into `out`, which must stay the caller's until it is done.
                await _to_the_end(run_blocking(cost_ns * 1e-9, _fill, out, self._job(frame)))
            else:
                image = await asyncio.shield(frame.pixels)
                await _to_the_end(run_blocking(0.0, np.copyto, out, image))
        await sleep_until_ns(began_ns + cost_ns)

    async def disarm(self) -> None:
        """Stop exposing; what has not arrived is reported as a gap."""
        run, tasks = self._run, self._tasks
        self._run, self._tasks = None, []
        if run is None:
            return
        self._bench.trigger = None
        self._bench.exposures = 0
        for task in tasks:
            task.cancel()
        run.end()
        await asyncio.wait(tasks)

    async def temperature_c(self) -> float | None:
        """How warm the sensor is, as its options have it."""
        return self._options.sensor.temperature_c

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of what it can look at."""
        return tuple(SCENES)

    @property
    def scene(self) -> str:
        """What it looks at."""
        return self._options.scene

    async def show(self, scene: str) -> None:
        """Look at another scene. In real time it is made now, which can take seconds."""
        if self._run is not None:
            raise DeviceBusy("it is armed.", device=self._name, operation="show", hint="disarm it first.")
        if scene not in SCENES:
            raise OutOfRange(
                f"there is no scene {scene!r}; there are: {', '.join(SCENES)}.", device=self._name, operation="show"
            )
        self._options = self._options.model_copy(update={"scene": scene})
        self._shown_s = (now_ns() - self._epoch_ns) * 1e-9
        if not is_virtual():
            await run_blocking(0.0, self._load, self._options.scene)

    def true_pixels(self, span: tuple[int, int]) -> Image:
        """What a frame shows during whose exposure the mirror was there, for `scanhsi.testing.witness`; without noise only."""
        settings = self._configured("true_pixels")
        assert settings.roi is not None
        return self._load(self._options.scene).render(
            *span,
            exposure_s=settings.exposure_s,
            gain_db=settings.gain_db,
            shape=settings.roi.shape,
            offset=(settings.roi.band_offset, settings.roi.sample_offset),
            bits=settings.pixel_format.bits,
            index=0,
        )

    def shortest_trigger_period_s(self) -> float:
        """Exposure, read-out or transfer, whichever takes longest.

        Transfers may take a little less than the period on average; the camera's own memory levels out their differences.
        """
        return max(self._shortest_period_s(), self._link_period_s())

    def _link_period_s(self) -> float:
        survey = self._delays(streams=delay_streams(self._profile, _SURVEY_SEED, self._options.block_lines))
        link_ns = np.array([survey.ns("T_rx", line) + survey.ns("T_api", line) for line in range(_SURVEYED)])
        mean_s = survey.mean_s("T_rx") + survey.mean_s("T_api")
        return levelled_period_s(mean_s, long_run_spread_s(link_ns), _LEVELLING) if mean_s else 0.0

    async def set_frame_period(self, period_s: float) -> float:
        """Set the time between exposures in free run, rounded to whole ns."""
        allowed = Range(self._shortest_period_s(), float("inf"), unit="s")
        allowed.check("frame period", period_s, device=self._name)
        self._period_ns = round(period_s * 1e9)
        return self._period_ns * 1e-9

    def _shortest_period_s(self) -> float:
        settings = self._configured("trigger period")
        readout_s = float(self._streams.array_ns("T_rd", 1000).max()) * 1e-9
        if not self._overlap:
            return settings.exposure_s + readout_s
        return max(settings.exposure_s + self._profile.mean_s("T_dead"), readout_s)

    def _exposed(self, frame: SimulatedFrame) -> None:
        frame.scene, frame.acquisition = self._options.scene, self._armed
        if frame.scene == COLD_LAMP:
            frame.time_s -= self._shown_s
        self._light(frame)
        if self._ahead:
            frame.pixels = asyncio.get_running_loop().run_in_executor(None, self._job(frame))

    def _light(self, frame: SimulatedFrame) -> None:
        """Under a light that can be switched: nothing is seen unless it shines, and its age counts from when it was switched on."""
        assert frame.exposure_start_ns is not None
        since_ns = self._bench.lit_since(frame.exposure_start_ns)
        if since_ns == math.inf:
            frame.scene = "dark"
        elif since_ns > -math.inf:
            frame.time_s -= (since_ns - self._epoch_ns) * 1e-9

    def _job(self, frame: SimulatedFrame) -> Callable[[], Image]:
        """What renders a frame. It does not hold the frame, whose buffer returns when its receiver lets it go."""
        settings, roi, scene, view = frame.settings, frame.settings.roi, frame.scene, frame.view
        index, acquisition, time_s = frame.index, frame.acquisition, frame.time_s
        assert roi is not None

        def render() -> Image:
            return self._load(scene).render(
                *view,
                exposure_s=settings.exposure_s,
                gain_db=settings.gain_db,
                shape=roi.shape,
                offset=(roi.band_offset, roi.sample_offset),
                bits=settings.pixel_format.bits,
                index=index,
                acquisition=acquisition,
                time_s=time_s,
            )

        return render

    def _load(self, scene: str) -> Scene:
        with _building:
            return _scene_of(scene, self._options.setup())

    def _delays(self, settings: CameraSettings | None = None, *, streams: DelayStreams | None = None) -> LineDelays:
        settings = settings or self._configured("delays")
        sensor = Roi(0, 0, self._options.samples, self._options.bands)
        sent = sensor if sends_whole(self._options, self._profile) else settings.roi
        assert sent is not None
        return LineDelays(streams or self._streams, settings, sent, sensor)

    def _configured(self, operation: str) -> CameraSettings:
        if self._settings is None:
            raise self._error("it is not configured.", operation)
        return self._settings

    def _error(self, message: str, operation: str) -> DeviceError:
        return DeviceError(message, device=self._name, operation=operation)


class OverlappingCamera(SimulatedCamera):
    """A camera that exposes while it reads out the frame before, as the paper's does."""

    _overlap = True

    def dead_time_s(self) -> float:
        """Time between the end of one exposure and the earliest start of the next."""
        return self._profile.mean_s("T_dead")


def create_camera(options: CameraOptions) -> SimulatedCamera:
    """The camera that the options describe."""
    return OverlappingCamera(options) if options.overlap else SimulatedCamera(options)


def _fill(out: Pixels, render: Callable[[], Image]) -> None:
    np.copyto(out, render())


async def _to_the_end(work: Awaitable[T]) -> T:
    """Await work that must not be left half done: a cancellation is raised when it has ended."""
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is not None:
        raise cancelled
    return task.result()

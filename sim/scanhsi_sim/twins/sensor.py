"""The camera twin's sensor: what triggers an exposure, how long it takes, what the mirror did meanwhile.

A state machine without threads or sockets: it is told the time and what happened, and answers with finished exposures.
All times are CLOCK_MONOTONIC in ns, as the mirror's are.

It behaves as a global-shutter camera with one frame of overlap: the next exposure may begin while the last frame is read
out, but not before the sensor could be read out since; a trigger that comes too early is lost, as on a real camera, and
counted.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum

from scanhsi_sim.twins.mirror import MirrorReading

READOUT_NS = 18_000_000
"""Shortest time from trigger to trigger. The free run is slower, 20.2 ms a frame: what the link carries."""

LINK_PERIOD_NS = 20_202_000
LEAD_NS = 500_000
"""How long before the end of an exposure the mirror is looked at once more."""

STEPS_PER_TURN = 19_200


class Source(IntEnum):
    """What starts exposures: values of TriggerSource in the GenICam description."""

    FREE_RUN = 0
    LINE1 = 1
    FIXED_RATE = 5
    SOFTWARE = 6


@dataclass(frozen=True, slots=True)
class Settings:
    """What the registers say.

    Attributes:
        source: What starts exposures.
        exposure_us: Exposure time.
        period_us: Frame period of the fixed rate.
        gain_tenths: Gain in 0.1 dB.
        pixel_format: PFNC code.
        shape: (bands, samples).
        offset: (band, sample) of the first pixel.
    """

    source: Source
    exposure_us: int
    period_us: int
    gain_tenths: int
    pixel_format: int
    shape: tuple[int, int]
    offset: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Exposed:
    """A finished exposure: lowest and highest mirror step while the shutter was open."""

    settings: Settings
    index: int
    start_ns: int
    end_ns: int
    step_low: int
    step_high: int


@dataclass(slots=True)
class Counters:
    """What happened since the twin started.

    Attributes:
        exposures: Finished exposures.
        busy: Triggers lost because they came during an exposure or too soon after it began.
        unread: Exposures not made because the camera's memory was full of frames not yet sent.
        ignored: Pulses and software triggers that came while something else, or nothing, was armed.
        smeared: Exposures during which the mirror moved.
        lateness_ns: For each exposure, how long after its start and after its end the twin looked at the mirror.
    """

    exposures: int = 0
    busy: int = 0
    unread: int = 0
    ignored: int = 0
    smeared: int = 0
    lateness_ns: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])


@dataclass(slots=True)
class _Shutter:
    """An exposure in progress."""

    settings: Settings
    start_ns: int
    end_ns: int
    step: int
    count: int  # steps the mirror had made when it began
    seen: MirrorReading  # the last look at the mirror
    late_ns: int  # how late the first look was
    checked: bool = False  # whether the look shortly before the end is done


@dataclass(slots=True)
class Sensor:
    """See the module docstring.

    Attributes:
        look: Reads the mirror.
        has_room: Whether the camera's memory takes another frame.
    """

    look: Callable[[], MirrorReading]
    has_room: Callable[[], bool]
    counters: Counters = field(default_factory=Counters)
    _settings: Settings | None = None
    _open: _Shutter | None = None
    _ready_ns: int = 0  # earliest next trigger
    _next_ns: int | None = None  # next exposure of a free run
    _index: int = 0

    @property
    def acquiring(self) -> bool:
        """Whether an acquisition is on."""
        return self._settings is not None

    def start(self, settings: Settings, now_ns: int) -> None:
        """Begin an acquisition, or go on with other settings from the next exposure on."""
        if self._settings is None:
            self._index, self._ready_ns = 0, 0
        if not self._settings or self._settings.source is not settings.source:
            self._next_ns = now_ns if settings.source in (Source.FREE_RUN, Source.FIXED_RATE) else None
        self._settings = settings

    def stop(self) -> None:
        """End the acquisition; an exposure in progress is given up."""
        self._settings = self._open = self._next_ns = None

    def trigger(self, source: Source, host_ns: int, now_ns: int, position: int | None = None) -> None:
        """A trigger has come. Call `advance` first.

        Args:
            source: Where from.
            host_ns: When it came; the exposure begins then.
            now_ns: The time now, a little later.
            position: Mirror position at that time, if the trigger tells it.
        """
        if self._settings is None or self._settings.source is not source:
            self.counters.ignored += 1
        elif self._open or host_ns < self._ready_ns:
            self.counters.busy += 1
        else:
            self._expose(self._settings, host_ns, now_ns, position)

    def wakeup_ns(self) -> int | None:
        """When to call `advance` next; None: not before something happens."""
        if self._open:
            return self._open.end_ns if self._open.checked else self._open.end_ns - LEAD_NS
        return self._next_ns

    def advance(self, now_ns: int) -> Iterator[Exposed]:
        """Let time pass; yield the exposures that have ended."""
        while (due := self.wakeup_ns()) is not None and due <= now_ns:
            if self._open is None:
                self._free_run(due, now_ns)
            elif now_ns >= self._open.end_ns:
                shutter, self._open = self._open, None
                yield self._close(shutter, now_ns)
            else:
                self._open.seen = self.look()
                self._open.checked = True

    def _free_run(self, due_ns: int, now_ns: int) -> None:
        if self._settings is None:
            return
        start_ns = due_ns if now_ns - due_ns < LINK_PERIOD_NS else now_ns  # after a stall, begin anew
        wanted_ns = self._settings.period_us * 1000 if self._settings.source is Source.FIXED_RATE else 0
        self._next_ns = start_ns + max(wanted_ns, LINK_PERIOD_NS, self._settings.exposure_us * 1000)
        self._expose(self._settings, start_ns, now_ns, None)

    def _expose(self, settings: Settings, start_ns: int, now_ns: int, position: int | None) -> None:
        if not self.has_room():
            self.counters.unread += 1
            return
        mirror = self.look()
        moved = mirror.last_step_host_ns > start_ns  # between the trigger and this look, so during the exposure
        step = mirror.position_steps if position is None else position
        count = mirror.step_count - max(abs(mirror.position_steps - step), int(moved))
        end_ns = start_ns + settings.exposure_us * 1000
        self._ready_ns = max(end_ns, start_ns + READOUT_NS)
        self._open = _Shutter(settings, start_ns, end_ns, step, count, mirror, late_ns=now_ns - start_ns)

    def _close(self, shutter: _Shutter, now_ns: int) -> Exposed:
        mirror = self.look()
        if mirror.last_step_host_ns > shutter.end_ns:
            mirror = shutter.seen  # it has moved on since the end: what it showed before is what the sensor saw
        low, high = sorted((shutter.step, mirror.position_steps))
        steps = mirror.step_count - shutter.count
        high = max(high, low + (steps + 1) // 2)  # it may have moved and come back
        self.counters.exposures += 1
        self.counters.smeared += high > low
        self.counters.lateness_ns.append((shutter.late_ns, now_ns - shutter.end_ns))
        self._index += 1
        wrapped = (low + STEPS_PER_TURN // 2) % STEPS_PER_TURN - STEPS_PER_TURN // 2
        return Exposed(
            shutter.settings, self._index - 1, shutter.start_ns, shutter.end_ns, wrapped, wrapped + high - low
        )

"""The camera twin's sensor: what triggers an exposure, and how long it takes.

A state machine without threads or sockets: it is told the time and what happened, and answers with finished exposures.
All times are CLOCK_MONOTONIC in ns, as the mirror's are. An exposure lasts from its trigger's own time stamp on, so it is
exact however late the twin's process wakes up.

It behaves as a global-shutter camera with one frame of overlap: the next exposure may begin while the last frame is read
out, but not before the sensor could be read out since; a trigger that comes too early is lost, as on a real camera, and
counted.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum

READOUT_NS = 18_000_000
"""Shortest time from trigger to trigger. The free run is slower, 20.2 ms a frame: what the link carries."""

LINK_PERIOD_NS = 20_202_000


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
class Exposure:
    """An exposure: when the shutter is open, and how many there were before in this acquisition."""

    settings: Settings
    index: int
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class Counters:
    """What happened since the twin started.

    Attributes:
        exposures: Finished exposures.
        busy: Triggers lost because they came during an exposure or too soon after it began.
        unread: Exposures not made because the camera's memory was full of frames not yet sent.
        ignored: Pulses and software triggers that came while something else, or nothing, was armed.
    """

    exposures: int = 0
    busy: int = 0
    unread: int = 0
    ignored: int = 0


@dataclass(slots=True)
class Sensor:
    """See the module docstring.

    Attributes:
        has_room: Whether the camera's memory takes another frame.
        counters: What happened.
    """

    has_room: Callable[[], bool]
    counters: Counters = field(default_factory=Counters)
    _settings: Settings | None = None
    _open: Exposure | None = None
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
        if self._settings is None or self._settings.source is not settings.source:
            self._next_ns = now_ns if settings.source in (Source.FREE_RUN, Source.FIXED_RATE) else None
        self._settings = settings

    def stop(self) -> None:
        """End the acquisition; an exposure in progress is given up."""
        self._settings = self._open = self._next_ns = None

    def trigger(self, source: Source, host_ns: int) -> None:
        """A trigger has come. Call `advance` first.

        Args:
            source: Where from.
            host_ns: When it came; the exposure begins then.
        """
        if self._settings is None or self._settings.source is not source:
            self.counters.ignored += 1
        elif self._open or host_ns < self._ready_ns:
            self.counters.busy += 1
        else:
            self._expose(self._settings, host_ns)

    def wakeup_ns(self) -> int | None:
        """When to call `advance` next; None: not before something happens."""
        return self._open.end_ns if self._open else self._next_ns

    def advance(self, now_ns: int) -> Iterator[Exposure]:
        """Let time pass; yield the exposures that have ended."""
        while (due := self.wakeup_ns()) is not None and due <= now_ns:
            if self._open is None:
                self._free_run(due, now_ns)
            else:
                ended, self._open = self._open, None
                self.counters.exposures += 1
                yield ended

    def _free_run(self, due_ns: int, now_ns: int) -> None:
        if self._settings is None:
            return
        start_ns = due_ns if now_ns - due_ns < LINK_PERIOD_NS else now_ns  # after a stall, begin anew
        wanted_ns = self._settings.period_us * 1000 if self._settings.source is Source.FIXED_RATE else 0
        self._next_ns = start_ns + max(wanted_ns, LINK_PERIOD_NS, self._settings.exposure_us * 1000)
        self._expose(self._settings, start_ns)

    def _expose(self, settings: Settings, start_ns: int) -> None:
        if not self.has_room():
            self.counters.unread += 1
            return
        end_ns = start_ns + settings.exposure_us * 1000
        self._ready_ns = max(end_ns, start_ns + READOUT_NS)
        self._open = Exposure(settings, self._index, start_ns, end_ns)
        self._index += 1

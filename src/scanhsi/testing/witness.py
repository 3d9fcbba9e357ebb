"""Who knows what is true: a simulated device that tells where its mirror really was, and what a frame had to show.

The check of a scan compares what was stored with that, and not with what the devices said to the engine.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Span = tuple[int, int]
"""Lowest and highest step of the mirror during some time; the same where it stood still."""


@runtime_checkable
class KnowsMirror(Protocol):
    """An actuator that knows where its mirror truly is, whatever it tells."""

    def true_span(self, start_ns: int, end_ns: int) -> Span:
        """Where the mirror was between two times of the loop clock, in steps. It may look back over the last few motions only."""
        ...


@runtime_checkable
class KnowsScene(Protocol):
    """A camera that knows what it looks at."""

    def true_pixels(self, span: Span) -> NDArray[Any]:
        """(bands, samples) of a frame, at the present settings, during whose exposure the mirror was there."""
        ...


@dataclass(slots=True)
class Sight:
    """One true exposure.

    Attributes:
        number: Exposures since the witness began.
        start_ns: When it truly began, loop clock.
        end_ns: When the shutter truly closed.
        span: Where the mirror truly was while the frame was integrated.
        still: Whether the mirror stood still from start to end.
        offset: Steps by which the actuator is wrong about itself: reported minus true.
        homed: Whether it had found its home since it was opened, or reset.
        pixels: What the frame truly shows.
        frame_id: Number on the frame as it was handed on; None before that.
    """

    number: int
    start_ns: int
    end_ns: int
    span: Span
    still: bool
    offset: int
    homed: bool
    pixels: NDArray[Any]
    frame_id: int | None = None

    @property
    def reported(self) -> Span:
        """The span, in steps as the actuator counts them."""
        return self.span[0] + self.offset, self.span[1] + self.offset


@dataclass(slots=True)
class Witness:
    """Sees what truly happens, through devices that know it; of others it sees nothing.

    Attributes:
        keeps: Whether it notes exposures; each takes the memory of a frame. Without, only the state of the devices.
        sights: By the start of each exposure.
        offset: Of the actuator, now: reported minus true.
        homed: Whether the actuator has found its home since it was opened, or reset.
        most_frames: Most frames that were alive at once.
        buffers: Most that there were at once, those of frames still held from an earlier arming included.
        armed: Whether the camera is.
        alive: Frames that somebody holds now.
        moved: Whether anything was told to move or expose.
        mirror, scene: Who knows.
    """

    keeps: bool = True
    sights: dict[int, Sight] = field(default_factory=dict[int, Sight])
    offset: int = 0
    homed: bool = False
    most_frames: int = 0
    buffers: int = 0
    armed: bool = False
    alive: int = 0
    moved: bool = False
    mirror: KnowsMirror | None = None
    scene: KnowsScene | None = None
    _warm: tuple[int, float] | None = None

    def exposed(self, start_ns: int, end_ns: int, shut_ns: int, offset: int | None = None) -> None:
        """Note an exposure, once; later than its end, but not by much.

        Args:
            start_ns: When it began.
            end_ns: Until when the frame was integrated.
            shut_ns: When the shutter closed.
            offset: Of the actuator, at its start; by default as it is now.
        """
        if not self.keeps or start_ns in self.sights or self.mirror is None or self.scene is None:
            return
        span, (low, high) = self.mirror.true_span(start_ns, end_ns), self.mirror.true_span(start_ns, shut_ns)
        pixels = np.asarray(self.scene.true_pixels(span))
        wrong = self.offset if offset is None else offset
        self.sights[start_ns] = Sight(len(self.sights), start_ns, shut_ns, span, low == high, wrong, self.homed, pixels)

    def arm(self, buffers: int) -> None:
        """The camera has new buffers; frames that somebody still holds lie in earlier ones."""
        self.armed, self.buffers = True, max(self.buffers, buffers + self.alive)

    def came(self) -> None:
        """A frame is there."""
        self.alive += 1
        self.most_frames = max(self.most_frames, self.alive)

    def gone(self) -> None:
        """Nobody holds that frame any more."""
        self.alive -= 1

    def warm_from(self, when_ns: int, counts_a_s: float) -> None:
        """From now on the dark level rises."""
        if self._warm is None:
            self._warm = when_ns, counts_a_s

    def warmth(self, when_ns: int | None) -> int:
        """By how many counts the dark level has risen."""
        if self._warm is None or when_ns is None:
            return 0
        since_ns, counts_a_s = self._warm
        return max(0, round((when_ns - since_ns) * 1e-9 * counts_a_s))

    def still(self, start_ns: int, end_ns: int) -> bool:
        """Whether the mirror stands still, or nobody knows."""
        if self.mirror is None:
            return True
        low, high = self.mirror.true_span(start_ns, end_ns)
        return low == high

"""The bench on which simulated camera and actuator stand: the mirror that one turns and the other sees, and the trigger cable.

Devices with the same bench name in one process share a bench. It lives as long as one of its devices.
"""

from __future__ import annotations

import bisect
import math
import weakref
from collections.abc import Callable

from scanhsi.devices.errors import DeviceBusy
from scanhsi_sim.effects import MirrorOptions
from scanhsi_sim.mirror import error_steps, follow

_KEPT = 512  # corners of the mirror's course; exposures look back over a handful


class Mirror:
    """Position of the mirror over time, in steps: a polyline of where the motor is, and from it where the mirror looks."""

    def __init__(self, step: int = 0, errors: MirrorOptions | None = None, seed: int = 0) -> None:
        """Args: step, where it stands; errors, of the mirror against the motor; seed, of its jitter."""
        self._times: list[int] = [0]
        self._steps: list[float] = [step]
        self._lagging: list[float] = [step]  # the mirror at the same corners, with the play of the belt
        self._corners = 1  # also those forgotten
        self._errors = errors or MirrorOptions()
        self._seed = seed

    @property
    def still_from_ns(self) -> int:
        """When the last motion ends, or ended."""
        return self._times[-1]

    def move(self, start_ns: int, end_ns: int, step: int) -> None:
        """Turn to `step` at constant speed, from `start_ns` to `end_ns`; before, stand where the last motion ended."""
        if len(self._times) > _KEPT:
            del self._times[: _KEPT // 2], self._steps[: _KEPT // 2], self._lagging[: _KEPT // 2]
        self._add(start_ns, self._steps[-1])
        self._add(end_ns, step)

    def _add(self, when_ns: int, step: float) -> None:
        self._times.append(when_ns)
        self._steps.append(step)
        self._lagging.append(follow(self._lagging[-1], step, self._errors.backlash_steps))
        self._corners += 1

    def halt(self, now_ns: int) -> int:
        """Stop at once, at the nearest step, which is returned."""
        place = self.position(now_ns)
        step = round(place)
        keep = bisect.bisect_right(self._times, now_ns)
        if keep < len(self._times):
            self._corners -= len(self._times) - keep
            del self._times[keep:], self._steps[keep:], self._lagging[keep:]
            self._add(now_ns, place)
            self._add(now_ns, step)
        return step

    def position(self, when_ns: int, *, before: bool = False) -> float:
        """Position of the motor at a time, in steps; `before` a motion without duration that comes at that very time."""
        right = (bisect.bisect_left if before else bisect.bisect_right)(self._times, when_ns)
        if right == len(self._times):
            return self._steps[-1]
        if right == 0:
            return self._steps[0]
        start, end = self._times[right - 1], self._times[right]
        share = (when_ns - start) / (end - start)
        return self._steps[right - 1] + share * (self._steps[right] - self._steps[right - 1])

    def span(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Lowest and highest step of the motor during an interval. Equal if it stood still."""
        inside = self._steps[bisect.bisect_right(self._times, start_ns) : bisect.bisect_left(self._times, end_ns)]
        places = [self.position(start_ns), *inside, self.position(end_ns, before=True)]
        # Times are whole ns, so positions on the way are off by up to some 1e-6 steps.
        return math.floor(min(places) + 1e-3), math.ceil(max(places) - 1e-3)

    def view(self, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Lowest and highest place that the mirror looks at during an interval, in steps, errors included.

        Where it stood still both are the same, and exact. Of a mirror that moves, the ends are known as well as its span.
        """
        low, high = self.span(start_ns, end_ns)
        errors = self._errors
        if errors == MirrorOptions():
            return low, high
        right = bisect.bisect_right(self._times, start_ns)
        lagging = self._lagging[max(right - 1, 0)]
        motion = (self._corners - len(self._times) + right) // 2
        first = follow(lagging, self.position(start_ns), errors.backlash_steps)
        last = first if low == high else follow(first, self.position(end_ns, before=True), errors.backlash_steps)
        places = [place + error_steps(errors, place, motion, self._seed) for place in (first, last)]
        return min(places), max(places)


class Bench:
    """What simulated camera and actuator share.

    Attributes:
        mirror: The mirror.
        exposures: Exposures since the camera was armed: the line that the next exposure is. Delays of a move are those of the
            line that it leads to, whatever the scan mode.
        pixel_format: Of the camera as it was armed last: a recorded move is replayed with the frame that it was recorded with.
        trigger: The camera's trigger input, while it listens: takes the time of a pulse in ns.
        lit: When the light was switched, in ns, and whether on; empty while there is none that could be.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.mirror = Mirror()
        self.exposures = 0
        self.pixel_format: str | None = None
        self.trigger: Callable[[int], None] | None = None
        self.lit: list[tuple[int, bool]] = []
        self._owners: weakref.WeakValueDictionary[str, object] = weakref.WeakValueDictionary()

    def claim(self, role: str, device: object, name: str) -> None:
        """Make `device` the camera or the actuator of this bench.

        Raises:
            DeviceBusy: Another one is connected.
        """
        owner = self._owners.setdefault(role, device)
        if owner is not device:
            raise DeviceBusy(
                f"bench {self.name!r} has a connected {role} already.",
                device=name,
                operation="connect",
                hint='close it, or give this instrument a bench of its own with bench = "...".',
            )

    def release(self, role: str, device: object) -> None:
        """Undo `claim`; nothing happens to a claim of another device."""
        if self._owners.get(role) is device:
            del self._owners[role]

    def lit_since(self, when_ns: int) -> float:
        """When the light that shone at a time was switched on, in ns; -inf for one that cannot be switched, inf in the dark."""
        if not self.lit:
            return -math.inf
        at_ns, on = next((entry for entry in reversed(self.lit) if entry[0] <= when_ns), (0, False))
        return at_ns if on else math.inf

    def pulse(self, when_ns: int) -> None:
        """A pulse on the trigger cable. Nobody hears it unless the camera listens."""
        if self.trigger is not None:
            self.trigger(when_ns)


_benches: weakref.WeakValueDictionary[str, Bench] = weakref.WeakValueDictionary()


def bench(name: str) -> Bench:
    """The bench of that name in this process."""
    return _benches.setdefault(name, Bench(name))

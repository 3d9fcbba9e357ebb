"""Optional abilities of devices. A driver has one by having its methods: there is no flag to get wrong.

A plan that needs an ability the device lacks is refused before anything moves, with the name of the ability (`require`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from scanhsi.devices.actuator import Motion
from scanhsi.devices.camera import Exposure
from scanhsi.devices.errors import UnsupportedFeature


@dataclass(frozen=True, slots=True)
class Sweep:
    """A constant-velocity motion through ``count`` evenly spaced positions.

    Attributes:
        first: Step of the first line.
        every: Steps between lines; negative sweeps downwards, never 0.
        count: Number of lines.
        rate_steps_s: Speed while lines are taken, > 0. The run-up before ``first`` and the run-out behind the last line are the
            driver's business, and have to fit into the limits.
        pulses: Give a trigger pulse exactly at each of the ``count`` positions.
    """

    first: int
    every: int
    count: int
    rate_steps_s: float
    pulses: bool = False

    @property
    def last(self) -> int:
        """Step of the last line."""
        return self.first + self.every * (self.count - 1)

    @property
    def period_s(self) -> float:
        """Time from line to line."""
        return abs(self.every) / self.rate_steps_s


@dataclass(frozen=True, slots=True)
class Sighting:
    """Where the mirror was seen in the middle of a motion.

    Attributes:
        step: Position, in whole steps as the controller counts them.
        at_ns: When, loop clock.
        uncertain_ns: By how much ``at_ns`` may be wrong, either way.
    """

    step: int
    at_ns: int
    uncertain_ns: int


@runtime_checkable
class Sweeps(Protocol):
    """An actuator that moves at constant velocity, with position triggers where asked and possible."""

    def check_sweep(self, sweep: Sweep) -> Sweep:
        """Refuse a sweep that cannot be done, before anything moves; return it as it will be run.

        A controller that knows only whole steps per second rounds the rate *down*, so that no line comes sooner than asked.

        Raises:
            OutOfRange: Limits (run-up and run-out included) or speed.
            UnsupportedFeature: Pulses are asked for and there is no trigger output.
        """
        ...

    def extent(self, sweep: Sweep) -> tuple[int, int]:
        """Lowest and highest step that a sweep reaches, run-up and run-out included."""
        ...

    def run_up_s(self, sweep: Sweep) -> float:
        """Time from the call of `sweep` to the moment the mirror passes ``first``, as well as the driver can tell."""
        ...

    async def prepare_sweep(self, sweep: Sweep) -> Motion:
        """Move to the start of the run-up. The camera is armed after this and before `sweep`."""
        ...

    async def sweep(self, sweep: Sweep) -> Motion:
        """Run the prepared sweep; return when the mirror stands again behind the last line.

        ``Motion.commanded_ns`` is the time at which the motion *passed ``first``* where the driver knows it, else when it was
        commanded; ``Motion.pulses`` counts the pulses given.
        """
        ...

    async def locate(self) -> Sighting:
        """Ask the controller where the mirror is; may run beside `sweep`.

        The engine asks when the frames of a sweep make it doubt which line they belong to, and beside a camera that runs free up to
        67 times a second.
        """
        ...


@runtime_checkable
class HardwareTriggered(Protocol):
    """A camera whose exposures can be started by a pulse (``arm(Trigger.LINE)``)."""

    def shortest_trigger_period_s(self) -> float:
        """Shortest time between two pulses at the present settings so that none is lost."""
        ...


@runtime_checkable
class FreeRunning(Protocol):
    """A camera that exposes on its own clock (``arm(Trigger.FREE_RUN)``)."""

    async def set_frame_period(self, period_s: float) -> float:
        """Set the time between exposures; return it as applied. Before ``arm``.

        Raises:
            OutOfRange: Shorter than exposure and read-out allow.
        """
        ...


@runtime_checkable
class OverlapsReadout(Protocol):
    """A camera that exposes the next frame while it reads out the last one."""

    def dead_time_s(self) -> float:
        """Time between the end of one exposure and the earliest start of the next."""
        ...


@runtime_checkable
class TellsStart(Protocol):
    """An actuator that tells when its motions begin: ``Motion.started_ns`` of `move_to` is set."""

    def least_latency_s(self, step: int) -> float:
        """Shortest time from the call of ``move_to(step)``, now, to the begin of its motion: the command's time on the wire, say.

        0 where nothing is sure.
        """
        ...


@runtime_checkable
class ForetellsEnd(Protocol):
    """A camera that tells the end of an exposure while it lasts."""

    async def expose_foretold(self, foretold: Callable[[int], None]) -> Exposure:
        """As ``expose``, and tell the end of the exposure as soon as the camera has the trigger.

        Args:
            foretold: Called once, in the event loop, with the ``end_ns`` that will be returned.
        """
        ...


@runtime_checkable
class MeasuresTemperature(Protocol):
    """A camera that can tell how warm its sensor is: dark signal doubles every few kelvin, so every cube keeps it."""

    async def temperature_c(self) -> float | None:
        """Temperature of the sensor, in degrees Celsius; None where this model of the camera does not know it.

        May be called at any time between ``connect`` and ``close`` when the camera is not armed.
        """
        ...


async def sensor_temperature_c(camera: object) -> float | None:
    """How warm a camera's sensor is; None where it cannot tell."""
    return await camera.temperature_c() if isinstance(camera, MeasuresTemperature) else None


@runtime_checkable
class ShowsScenes(Protocol):
    """A simulated camera that can be put before something else, as a person would put a tile before a real one."""

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of what it can look at."""
        ...

    @property
    def scene(self) -> str:
        """What it looks at."""
        ...

    async def show(self, scene: str) -> None:
        """Look at another scene from the next frame on.

        Raises:
            OutOfRange: There is none of that name.
            DeviceBusy: It is armed.
        """
        ...


CAPABILITIES: tuple[type, ...] = (
    Sweeps,
    TellsStart,
    HardwareTriggered,
    FreeRunning,
    OverlapsReadout,
    ForetellsEnd,
    MeasuresTemperature,
    ShowsScenes,
)

_C = TypeVar("_C")


def capabilities_of(device: object | type) -> tuple[str, ...]:
    """Names of the optional abilities that a device, or the class of one, has."""
    kind = device if isinstance(device, type) else type(device)
    return tuple(protocol.__name__ for protocol in CAPABILITIES if _has_members(kind, protocol))


def _has_members(kind: type, protocol: type) -> bool:
    """As ``issubclass``, which refuses protocols with properties."""
    members = [name for name in vars(protocol) if not name.startswith("_")]
    return all(getattr(kind, name, None) is not None for name in members)


def require(device: object, ability: type[_C], why: str, *, name: str) -> _C:
    """Return ``device`` as one that has ``ability``.

    Args:
        device: A camera or an actuator.
        ability: One of `CAPABILITIES`.
        why: What needs it (``"mode 'continuous'"``).
        name: How messages call the device.

    Raises:
        UnsupportedFeature: It has not; nothing was done.
    """
    if not isinstance(device, ability):
        has = ", ".join(capabilities_of(device)) or "none"
        raise UnsupportedFeature(
            f"{why} needs the ability {ability.__name__}, which this driver lacks (it has: {has}).",
            device=name,
        )
    return device

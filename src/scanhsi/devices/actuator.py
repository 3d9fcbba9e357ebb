"""The actuator contract: whatever turns the mirror.

Positions are integers in *steps* (one microstep of the motor); step 0 is where homing ends. An actuator driver is any class with
these methods. Calls come from one event loop, one at a time, except ``stop``, which may come at any moment::

    connect ──> home? ──> move_to* ──> stop ──> close ──> connect, anew

* **Time.** As in the camera contract: ns of the loop clock, sleeps through asyncio.
* **Limits.** A target outside ``info.limits`` raises `OutOfRange` before anything moves.
* **Deadlines.** Each motion has one, derived from its own length and speed: then the driver stops the motor and raises
  `DeviceTimeout`.
* **Position.** After a reset of the controller, or when steps were lost, every call but ``home``, ``stop`` and ``close`` raises
  `PositionLost`.
* **Cancellation.** A cancelled ``move_to``, ``sweep`` or ``home`` leaves the motor perhaps moving: the caller then calls ``stop``.
* **Reopening.** After ``close``, also of a controller that was lost, ``connect`` opens it anew. ``homed`` tells whether its steps
  still mean what they meant.
* **Safety.** ``stop`` always works: in any state, during a motion, after a failure, again and again. It returns when the mirror
  stands still or raises because it cannot know that.
* **Backlash.** ``move_to`` arrives from below wherever ``info.backlash_steps`` is not 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from scanhsi.devices.values import Range


@dataclass(frozen=True, slots=True)
class ActuatorInfo:
    """What a connected actuator is and allows.

    Attributes:
        name: How messages call it, with its port (``"actuator stepper /dev/ttyACM0"``).
        model, firmware: As the controller tells.
        steps_per_revolution: Steps of one turn of the *mirror* (19,200 in the paper).
        limits: Allowed targets, in steps.
        max_rate_steps_s: Highest speed.
        backlash_steps: Play of the drive; 0 where unknown or none.
        settle_s: Time the mirror is given after each step move.
        simulated: True for anything that is not a real mirror.
        finds_home: Whether ``home`` finds the same place by itself, with a switch or an index. Where it only takes the present
            position as zero, a lost position cannot be found again, and no scan goes on after one.
    """

    name: str
    model: str
    firmware: str
    steps_per_revolution: int
    limits: Range
    max_rate_steps_s: float
    backlash_steps: int = 0
    settle_s: float = 0.0
    simulated: bool = False
    finds_home: bool = True


@dataclass(frozen=True, slots=True)
class Motion:
    """One finished motion; loop clock, ns.

    Attributes:
        step: Position at the end, as the controller confirms it.
        commanded_ns: When the command was given.
        moved_ns: When the motion and its settling had ended.
        pulses: Trigger pulses given, for sweeps.
        started_ns: When the mirror began to move, where the driver can tell: never later than it did.
    """

    step: int
    commanded_ns: int
    moved_ns: int
    pulses: int = 0
    started_ns: int | None = None


@runtime_checkable
class Actuator(Protocol):
    """The actuator contract; see the module docstring for the rules that hold for every method."""

    @property
    def info(self) -> ActuatorInfo:
        """What the actuator is and allows. Known after ``connect``; raises `DeviceError` before."""
        ...

    @property
    def position(self) -> int:
        """Last position that the controller confirmed, in steps.

        Raises:
            PositionLost: It is not known.
        """
        ...

    @property
    def homed(self) -> bool:
        """Whether the zero of ``position`` is the home position, so that steps mean angles."""
        ...

    async def connect(self) -> None:
        """Open the controller. Moves nothing.

        Raises:
            DeviceNotFound: No such port, or nothing that speaks the protocol answers.
            DeviceBusy: The port is in use.
        """
        ...

    async def close(self) -> None:
        """Stop, then close the port. Never raises for a controller that is gone."""
        ...

    async def home(self) -> Motion:
        """Find the home position and make it step 0.

        Raises:
            MotionFailed: The home sensor was not found.
        """
        ...

    async def move_to(self, step: int) -> Motion:
        """Move to ``step``; return at the end of motion *and* settle.

        Raises:
            OutOfRange: Beyond the limits; nothing moved.
            MotionFailed: It stopped on the way; ``position`` is where.
        """
        ...

    async def stop(self) -> None:
        """Stop whatever moves, now. Always allowed.

        Raises:
            DeviceError: It cannot be known that the mirror stands still.
        """
        ...

"""The light contract: whatever illuminates the object, and can be switched.

A light driver is any class with these methods. Calls come from one event loop, one at a time, except ``off``, which may come at any
moment::

    connect ──> on* ──> off ──> close ──> connect, anew

* **Time.** As in the camera contract: ns of the loop clock, sleeps through asyncio.
* **Safety.** ``off`` always works: in any state, beside or after an ``on`` that was cancelled, after a failure, again and again.
  It returns when the light confirmed that it is off or raises because it cannot know that. An ``on`` never outlives an ``off``
  that came later. ``close`` switches off first.
* **Levels.** 0 is off; 1 is all it can do. A level outside ``info.levels`` raises `OutOfRange`, and nothing changes.
* **Warming up.** ``on`` returns when the light is lit, not when it is steady: `Lit.steady_ns` tells when that is. Whoever
  exposes waits for it.
* **Failure and cancellation.** Anything that goes wrong is a `DeviceError`. Every method may be cancelled at any await; ``off`` and
  ``close`` must still work.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from scanhsi.devices.values import Range


@dataclass(frozen=True, slots=True)
class LightInfo:
    """What a connected light is and allows.

    Attributes:
        name: How messages call it, with its port (``"light numato /dev/ttyACM1"``).
        model, firmware: As the controller tells.
        levels: Allowed levels of ``on``, 1 = all it can do; ``Range(1, 1)`` where it cannot be dimmed.
        warm_up_s: Time from switching on until it is steady.
        simulated: True for anything that is not a real light.
    """

    name: str
    model: str
    firmware: str
    levels: Range
    warm_up_s: float = 0.0
    simulated: bool = False


@dataclass(frozen=True, slots=True)
class Lit:
    """A light that is on; loop clock, ns.

    Attributes:
        level: As the controller confirmed it.
        commanded_ns: When the command was given.
        lit_ns: Since when it is lit; of a light that was on already, since then.
        steady_ns: When it is, or was, warmed up.
    """

    level: float
    commanded_ns: int
    lit_ns: int
    steady_ns: int


@runtime_checkable
class Light(Protocol):
    """The light contract; see the module docstring for the rules that hold for every method."""

    @property
    def info(self) -> LightInfo:
        """What the light is and allows. Known after ``connect``; raises `DeviceError` before."""
        ...

    @property
    def level(self) -> float:
        """Last level that the controller confirmed; 0 = off.

        Raises:
            DeviceError: It is not known: not connected, or the last command was not confirmed.
        """
        ...

    async def connect(self) -> None:
        """Open the controller. Switches nothing.

        Raises:
            DeviceNotFound: No such port, or nothing that speaks the protocol answers.
            DeviceBusy: The port is in use.
        """
        ...

    async def close(self) -> None:
        """Switch off, then close the port. Never raises for a controller that is gone.

        Raises:
            DeviceError: It is there, and did not confirm that the light is off. It is closed all the same.
        """
        ...

    async def on(self, level: float | None = None) -> Lit:
        """Switch on, or change the level; return when it is lit.

        Args:
            level: One of ``info.levels``; None takes the level that the instrument file says, or else the highest.

        Raises:
            OutOfRange: The level is not allowed; nothing was switched.
        """
        ...

    async def off(self) -> None:
        """Switch off, now. Always allowed.

        Raises:
            DeviceError: It cannot be known that it is off.
        """
        ...

"""Who is in control: one holder at a time, until released or run out. Viewing needs none, STOP needs none."""

from __future__ import annotations

import asyncio
import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from scanhsi.clock import now_ns
from scanhsi.service.refusals import TAKE_CONTROL, LeaseHeld, NotInControl

SHORTEST_S: Final = 5.0
LONGEST_S: Final = 600.0
DEFAULT_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Holder:
    """Who is in control, as everybody may know.

    Attributes:
        name: As they call themselves.
        remaining_s: Until it runs out, if nothing is heard of them.
    """

    name: str
    remaining_s: float


@dataclass(slots=True)
class _Held:
    id: str
    name: str
    ttl_s: float
    until_ns: int


class Lease:
    """The one control lease.

    Args:
        changed: Called when the holder changes.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._held: _Held | None = None
        self._timer: asyncio.TimerHandle | None = None

    @property
    def holder(self) -> Holder | None:
        """Who is in control."""
        held = self._alive()
        return None if held is None else Holder(held.name, (held.until_ns - now_ns()) * 1e-9)

    def take(self, name: str, ttl_s: float = DEFAULT_S) -> str:
        """Take control; return the id that proves it, a secret.

        Raises:
            LeaseHeld: Somebody has it. It is not stolen: they release it, or it runs out.
        """
        held = self._alive()
        if held is not None:
            left_s = (held.until_ns - now_ns()) * 1e-9
            raise LeaseHeld(
                f"{held.name} is in control.",
                operation="take control",
                hint=f"ask them to release it, or wait: without a sign of life it runs out in {left_s:.0f} s",
            )
        self._held = _Held(secrets.token_urlsafe(24), name, min(max(ttl_s, SHORTEST_S), LONGEST_S), 0)
        self._extend(self._held)
        self._changed()
        return self._held.id

    def renew(self, id: str | None) -> Holder:
        """A sign of life: it runs from now on.

        Raises:
            NotInControl: It is not, or no longer, theirs.
        """
        held = self._alive()
        if held is None or id is None or not hmac.compare_digest(held.id.encode(), id.encode()):
            who = "nobody is in control" if held is None else f"{held.name} is in control"
            raise NotInControl(f"this needs control; {who}.", hint=TAKE_CONTROL)
        self._extend(held)
        return Holder(held.name, held.ttl_s)

    def release(self, id: str | None) -> None:
        """Give control up.

        Raises:
            NotInControl: It is not theirs.
        """
        self.renew(id)
        self._end()

    def close(self) -> None:
        """The service ends."""
        if self._timer is not None:
            self._timer.cancel()
        self._held = None

    def _alive(self) -> _Held | None:
        return self._held if self._held is not None and now_ns() < self._held.until_ns else None

    def _extend(self, held: _Held) -> None:
        held.until_ns = now_ns() + round(held.ttl_s * 1e9)
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(held.ttl_s + 0.01, self._run_out, held)

    def _run_out(self, held: _Held) -> None:
        if self._held is held and self._alive() is None:
            self._end()

    def _end(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._held = None
        self._changed()

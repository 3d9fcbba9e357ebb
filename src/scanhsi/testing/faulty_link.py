"""A device that goes away: what a faulty camera and a faulty actuator share."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

from scanhsi.clock import now_ns
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceNotFound
from scanhsi.testing.faults import Fault, Faults, Kind, for_ever_s

T = TypeVar("T")

_WORDS: Final = {
    Kind.CONTROL_LOST: "another program has taken control",
    Kind.CAMERA_UNPLUGGED: "it is gone",
    Kind.ACTUATOR_UNPLUGGED: "it is gone",
}


class FaultyLink:
    """The cable to a device: calls go through it, until it is pulled.

    Args:
        faults: The plan under way.
        kinds: Faults that end the connection.
        on_lost: Called with the error in the moment of the loss.
    """

    def __init__(self, faults: Faults, kinds: tuple[Kind, ...], on_lost: Callable[[DeviceError], None]) -> None:
        self._faults = faults
        self._kinds = tuple(kind for kind in kinds if faults.has(kind))
        self._on_lost = on_lost
        self._why: str | None = None
        self._back_ns = 0.0
        self._lost = asyncio.Event()
        self._timers: list[asyncio.TimerHandle] = []

    def connect(self, device: str) -> None:
        """The device is opened anew.

        Raises:
            DeviceNotFound: It is still away.
        """
        if now_ns() < self._back_ns:
            raise DeviceNotFound("nothing answers.", device=device, operation="connect", hint="plug it in.")
        self._why, self._lost = None, asyncio.Event()

    def close(self) -> None:
        """Nothing can be lost any more."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def check(self, device: str, operation: str) -> None:
        """Refuse when the device is gone.

        Raises:
            DeviceLost: It is.
        """
        if self._why is not None:
            raise DeviceLost(f"{self._why}.", device=device, operation=operation, hint="connect it anew.")

    async def call(self, device: str, operation: str, call: Coroutine[Any, Any, T]) -> T:
        """Make a call of the device; it ends early when the device goes.

        Raises:
            DeviceLost: It went, or had gone.
        """
        if not self._kinds:
            return await call
        for kind in self._kinds:
            if (fault := self._faults.due(kind)) is not None:
                self._pull_later(fault)
        if self._why is not None:
            call.close()
        self.check(device, operation)
        task, gone = asyncio.ensure_future(call), asyncio.ensure_future(self._lost.wait())
        try:
            await asyncio.wait([task, gone], return_when=asyncio.FIRST_COMPLETED)
        finally:
            gone.cancel()
            if not task.done():
                task.cancel()
            await asyncio.wait([task, gone])
        if not task.cancelled() and self._why is None:
            return task.result()
        if not task.cancelled():
            task.exception()  # nobody hears it any more
        self.check(device, operation)
        raise asyncio.CancelledError

    def _pull_later(self, fault: Fault) -> None:
        if not fault.after_s:
            self._pull(fault)
        else:
            self._timers.append(asyncio.get_running_loop().call_later(fault.after_s, self._pull, fault))

    def _pull(self, fault: Fault) -> None:
        away_s = 0.0 if fault.kind is Kind.CONTROL_LOST else for_ever_s(fault.for_s)
        self._back_ns = now_ns() + away_s * 1e9 if math.isfinite(away_s) else math.inf
        self._why = _WORDS[fault.kind]
        self._lost.set()
        self._on_lost(DeviceLost(f"{self._why}.", hint="connect it anew."))

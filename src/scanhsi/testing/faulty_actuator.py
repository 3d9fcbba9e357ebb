"""An actuator that fails as a plan says, around any actuator: its optional abilities are those of the one inside."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, cast

from scanhsi.clock import now_ns
from scanhsi.devices import Actuator, ActuatorInfo, Motion, Sighting, Sweep, Sweeps, TellsStart
from scanhsi.devices.errors import DeviceTimeout, MotionFailed, PositionLost
from scanhsi.testing.faults import Fault, Faults, Kind
from scanhsi.testing.faulty_camera import wait_s
from scanhsi.testing.faulty_link import FaultyLink
from scanhsi.testing.witness import KnowsMirror, Witness

_INTERRUPTED = (Kind.MOTOR_STALLS, Kind.LIMIT_HIT, Kind.CONTROLLER_RESET)


class FaultyActuator:
    """Obeys the actuator contract but for what its plan says; made by `faulty_actuator`.

    Where steps were lost, what it tells (``position``, targets, sightings) and what is true differ by a constant.

    Args:
        inner: The actuator.
        faults: The plan under way.
        witness: Told what truly happens, if ``inner`` knows.
    """

    def __init__(self, inner: Actuator, faults: Faults, witness: Witness) -> None:
        self.inner = inner
        self._faults = faults
        self._witness = witness
        self._position_lost = False
        self._name = type(inner).__name__
        self._link = FaultyLink(faults, (Kind.ACTUATOR_UNPLUGGED,), lambda error: None)

    @property
    def info(self) -> ActuatorInfo:
        """As of the actuator inside."""
        return self.inner.info

    @property
    def position(self) -> int:
        """Where it believes to be."""
        self._check_position("position")
        return self.inner.position + self.offset

    @property
    def homed(self) -> bool:
        """Whether step 0 is the home position, as it believes."""
        return self.inner.homed and not self._position_lost

    @property
    def offset(self) -> int:
        """What it believes minus what is true."""
        return self._witness.offset

    async def connect(self) -> None:
        """Open it, if it is there."""
        self._link.connect(self._name)
        await self.inner.connect()
        self._name = self.inner.info.name
        self._position_lost = False
        self._witness.offset, self._witness.homed = 0, self.inner.homed
        if isinstance(self.inner, KnowsMirror):
            self._witness.mirror = self.inner

    async def close(self) -> None:
        """Close it, wherever it is."""
        self._link.close()
        await self.inner.close()

    async def home(self) -> Motion:
        """Home it, perhaps to the wrong place."""
        return await self._call("home", self._home())

    async def _home(self) -> Motion:
        self._witness.moved = True
        fault = self._faults.due(Kind.HOME_WRONG)
        motion = await self.inner.home()
        self._position_lost = False
        self._witness.offset, self._witness.homed = 0 if fault is None else round(fault.by), True
        return replace(motion, step=motion.step + self.offset)

    async def move_to(self, step: int) -> Motion:
        """Move, if it moves."""
        return await self._call(f"move_to {step}", self._move_to(step))

    async def _move_to(self, step: int) -> Motion:
        self._check_position("move_to")
        self.info.limits.check("step", step, device=self.info.name)
        return await self.make("move_to", lambda: self.inner.move_to(step - self.offset))

    async def stop(self) -> None:
        """Stop it, if it answers."""
        self._link.check(self.info.name, "stop")
        if (fault := self._faults.due(Kind.STOP_UNANSWERED)) is not None:
            await wait_s(fault.for_s)
            raise DeviceTimeout("no answer.", device=self.info.name, operation="stop")
        await self.inner.stop()

    # --- motions ----------------------------------------------------------------------------------------------------------

    async def make(self, operation: str, motion: Callable[[], Coroutine[Any, Any, Motion]]) -> Motion:
        """One motion of the actuator inside, with whatever happens in it."""
        self._witness.moved = True
        commanded_ns = now_ns()
        kinds = (*_INTERRUPTED, Kind.STEPS_LOST, Kind.MOVE_SLOW, Kind.REPLY_LOST, Kind.DONE_LOST)
        due = {kind: fault for kind in kinds if (fault := self._faults.due(kind)) is not None}
        if Kind.STEPS_LOST in due and operation != "sweep":
            self._witness.offset += round(due[Kind.STEPS_LOST].by)
        if Kind.MOVE_SLOW in due:
            await wait_s(due[Kind.MOVE_SLOW].for_s)
        for kind in _INTERRUPTED:
            if kind in due:
                made = await self._interrupted(operation, motion(), due[kind])
                break
        else:
            made = await motion()
        if Kind.REPLY_LOST in due:
            await wait_s(due[Kind.REPLY_LOST].for_s)
            raise DeviceTimeout("no answer.", device=self.info.name, operation=operation)
        moved_ns = made.moved_ns
        if Kind.DONE_LOST in due:
            await wait_s(due[Kind.DONE_LOST].for_s)
            moved_ns = now_ns()
        if operation != "sweep":
            made = replace(made, commanded_ns=commanded_ns)
        return replace(made, step=made.step + self.offset, moved_ns=moved_ns)

    async def _interrupted(self, operation: str, motion: Coroutine[Any, Any, Motion], fault: Fault) -> Motion:
        task = asyncio.ensure_future(motion)
        try:
            await asyncio.wait([task], timeout=fault.after_s)
            if task.done():
                return task.result()
            await self.inner.stop()
        finally:
            task.cancel()
            await asyncio.wait([task])
            if not task.cancelled():
                task.exception()
        device = self.info.name
        if fault.kind is Kind.LIMIT_HIT:
            raise MotionFailed("the limit switch stopped it.", device=device, operation=operation)
        if fault.kind is Kind.CONTROLLER_RESET:
            self._position_lost, self._witness.homed = True, False
            raise PositionLost("the controller has restarted.", device=device, operation=operation, hint="home it.")
        await wait_s(fault.for_s)
        raise DeviceTimeout("the motion did not end.", device=device, operation=operation)

    def _check_position(self, operation: str) -> None:
        if self._position_lost:
            raise PositionLost("nobody knows where it is.", device=self.info.name, operation=operation, hint="home it.")

    async def _call(self, operation: str, call: Coroutine[Any, Any, Motion]) -> Motion:
        return await self._link.call(self._name, operation, call)


class _Sweeping(FaultyActuator):
    @property
    def _sweeps(self) -> Sweeps:
        return cast(Sweeps, self.inner)

    def check_sweep(self, sweep: Sweep) -> Sweep:
        return self._sweeps.check_sweep(sweep)

    def extent(self, sweep: Sweep) -> tuple[int, int]:
        return self._sweeps.extent(sweep)

    def run_up_s(self, sweep: Sweep) -> float:
        return self._sweeps.run_up_s(sweep)

    async def prepare_sweep(self, sweep: Sweep) -> Motion:
        async def prepare() -> Motion:
            self._check_position("prepare_sweep")
            return await self.make("prepare_sweep", lambda: self._sweeps.prepare_sweep(self._true(sweep)))

        return await self._call("prepare_sweep", prepare())

    async def sweep(self, sweep: Sweep) -> Motion:
        async def run() -> Motion:
            self._check_position("sweep")
            return await self.make("sweep", lambda: self._sweeps.sweep(self._true(sweep)))

        return await self._call("sweep", run())

    async def locate(self) -> Sighting:
        self._link.check(self.info.name, "locate")
        seen = await self._sweeps.locate()
        return replace(seen, step=seen.step + self.offset)

    def _true(self, sweep: Sweep) -> Sweep:
        return replace(sweep, first=sweep.first - self.offset)


class _Telling(FaultyActuator):
    def least_latency_s(self, step: int) -> float:
        return cast(TellsStart, self.inner).least_latency_s(step - self.offset)


_ABILITIES: tuple[tuple[type, type[FaultyActuator]], ...] = ((Sweeps, _Sweeping), (TellsStart, _Telling))
_classes: dict[tuple[type, ...], type[FaultyActuator]] = {}


def faulty_actuator(inner: Actuator, faults: Faults, witness: Witness | None = None) -> FaultyActuator:
    """Put a plan's faults around an actuator.

    Args:
        inner: Any actuator.
        faults: The plan under way.
        witness: Told what truly happens, if ``inner`` knows.
    """
    parts = tuple(part for ability, part in _ABILITIES if isinstance(inner, ability))
    if parts not in _classes:
        _classes[parts] = type("FaultyActuator", parts or (FaultyActuator,), {})
    return _classes[parts](inner, faults, witness or Witness(keeps=False))

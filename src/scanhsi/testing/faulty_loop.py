"""A virtual event loop on which the computer itself fails as a plan says; and what of that can be done in real time."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from contextvars import Context
from random import Random
from typing import Any, Final, TypeVar, TypeVarTuple, Unpack

from scanhsi.clock import VirtualTimeLoop
from scanhsi.engine.steering import ScanControl
from scanhsi.testing.faults import Fault, Faults, Kind

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_WAKING_S: Final = 0.0005
_OF_CALLBACKS: Final = (Kind.LOOP_STALLS, Kind.PAUSED, Kind.STOP_REQUESTED, Kind.CANCELLED)


class FaultyLoop(VirtualTimeLoop):
    """A `VirtualTimeLoop` with the faults of a plan: stalls, a request to stop, a cancellation before any callback.

    Jobs run in the loop's own thread (``inline``), so that a scan with its storage runs the same way each time. Callbacks count
    from `watch` on, and only those given to ``call_soon``: task steps, wake-ups. Timers and jobs act through these.

    Args:
        faults: The plan under way.
        start: Initial time, in s.

    Attributes:
        callbacks: How many ran since `watch`.
        cancellations: How many were asked for.
    """

    def __init__(self, faults: Faults, start: float = 0.0) -> None:
        self.callbacks = 0
        self.cancellations = 0
        self._faults = faults
        self._kinds = tuple(kind for kind in _OF_CALLBACKS if faults.has(kind))
        self._watched: asyncio.Task[Any] | None = None
        self._control = ScanControl()
        self._job_s = 0.0
        self._waking = Random(faults.plan.seed)
        super().__init__(start=start, inline=True)

    def watch(self, task: asyncio.Task[Any], control: ScanControl) -> None:
        """From now on faults happen: to this task, a scan that is steered by ``control``, until it ends."""
        self._watched, self._control = task, control
        self._faults.begin(self.time_ns)

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Context | None = None) -> asyncio.Handle:
        """As asyncio's, counted."""
        if self._watched is None or not self._kinds:
            return super().call_soon(callback, *args, context=context)
        return super().call_soon(self._counted, callback, args, context=context)

    def _counted(self, callback: Callable[..., object], args: tuple[Any, ...]) -> None:
        task = self._watched
        if task is not None and not task.done():
            self.callbacks += 1
            for kind in self._kinds:
                if (fault := self._faults.due(kind)) is not None:
                    self._happen(fault, task)
        callback(*args)

    def _happen(self, fault: Fault, task: asyncio.Task[Any]) -> None:
        if fault.kind is Kind.LOOP_STALLS:
            self._jump(self.time() + (fault.for_s or 0.0))
        elif fault.kind is Kind.STOP_REQUESTED:
            self._control.stop.set()
        elif fault.kind is Kind.PAUSED:
            self._control.pause()
            if fault.for_s is not None:
                self.call_later(fault.for_s, self._control.go_on)
        else:
            self.cancellations += task.cancel()

    # Blocking work, at the latest moment at which a thread could do it

    def job_takes(self, for_s: float) -> None:
        """The job that runs now takes so much longer, on the virtual clock: what a slow write calls instead of sleeping."""
        self._job_s += for_s

    def run_blocking(self, cost_s: float, fn: Callable[[Unpack[Ts]], T], *args: *Ts) -> asyncio.Future[T]:
        """As of the virtual loop, but it is done at the end of its time, so that memory given away too early is seen to change.

        Work that costs nothing begins some hundred microseconds later, as a thread does that has to wake up.
        """
        future: asyncio.Future[T] = self.create_future()
        waits_s = cost_s or self._waking.uniform(0.0, _WAKING_S)
        self.call_later(waits_s, self._run_job, future, fn, args)
        return future

    def _run_job(self, future: asyncio.Future[Any], fn: Callable[..., Any], args: tuple[Any, ...]) -> None:
        self._job_s = 0.0
        result, problem = None, None
        try:
            result = fn(*args)
        except Exception as error:
            problem = error
        took_s, self._job_s = self._job_s, 0.0
        self.call_later(took_s, _deliver, future, result, problem)


def _deliver(future: asyncio.Future[Any], result: object, problem: Exception | None) -> None:
    if future.done():  # cancelled meanwhile
        return
    if problem is not None:
        future.set_exception(problem)
    else:
        future.set_result(result)


EPOCH_NS: Final = 1_800_000_000_000_000_000
"""Wall clock at the begin of virtual time."""


@contextmanager
def wall_clock(faults: Faults, loop: VirtualTimeLoop) -> Generator[None]:
    """Let the wall clock (``time.time_ns``) of this process follow virtual time while entered, and jump as a plan says."""
    original, ahead = time.time_ns, 0

    def stepping() -> int:
        nonlocal ahead
        if (fault := faults.due(Kind.CLOCK_STEP)) is not None:
            ahead += round(fault.by * 1e9)
        return EPOCH_NS + loop.time_ns() + ahead

    time.time_ns = stepping
    try:
        yield
    finally:
        time.time_ns = original


def real_host_faults(faults: Faults, task: asyncio.Task[Any], control: ScanControl) -> None:
    """Let the host faults of a plan that have ``at_s`` happen in the running real-time loop; those in the past are over."""
    loop = asyncio.get_running_loop()
    actions: dict[Kind, Callable[[Fault], object]] = {
        Kind.LOOP_STALLS: lambda fault: time.sleep(fault.for_s or 0.0),
        Kind.GIL_HOG: lambda fault: hog_the_interpreter(fault.for_s or 0.0),
        Kind.STOP_REQUESTED: lambda fault: control.stop.set(),
        Kind.CANCELLED: lambda fault: task.cancel(),
    }
    for fault in faults.plan.faults:
        if fault.kind in actions and fault.at_s is not None:
            loop.call_later(fault.at_s, actions[fault.kind], fault)


def hog_the_interpreter(for_s: float) -> threading.Thread:
    """Keep the interpreter lock busy from another thread, which is returned."""

    def spin() -> None:
        until = time.monotonic() + for_s
        while time.monotonic() < until:
            pass

    thread = threading.Thread(target=spin, name="scanhsi-gil-hog", daemon=True)
    thread.start()
    return thread

"""A deterministic event loop in virtual time.  All uses of asyncio's private names are here."""

import asyncio
import collections
import concurrent.futures
import contextlib
import math
import selectors
import threading
import time
from collections.abc import Callable, Generator
from contextvars import Context
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple, Unpack

T = TypeVar("T")
Ts = TypeVarTuple("Ts")
Events = list[tuple[selectors.SelectorKey, int]]

#: The virtual clock runs in [0, this).  asyncio keeps time in float seconds, whose spacing passes 1 ns near here, and from
#: 2**24 s on its own comparison of timers fails.  Keep wall-clock time as an offset beside the clock.
CLOCK_LIMIT_S = 1e7

_SPINS_PER_POLL = 64
# Tens of ms: a thread that wants the GIL and sees it let go briefly more often than every 5 ms may never get it.
_SPINS_PER_SIGNAL_CHECK = 1 << 16


class VirtualDeadlock(RuntimeError):
    """Nothing can ever happen again: tasks wait, but there is no callback, timer, job or hold left."""


class HoldTimeout(RuntimeError):
    """Virtual time stood still for a job or a hold for longer than ``hold_timeout`` real seconds."""


class _HookedSelector(selectors.DefaultSelector):
    """The platform's selector, whose ``select`` is answered by the loop, which uses :meth:`poll` itself."""

    def __init__(self, on_select: Callable[[float | None], Events]) -> None:
        super().__init__()
        self._on_select = on_select

    def select(self, timeout: float | None = None) -> Events:
        return self._on_select(timeout)

    def poll(self, timeout: float | None) -> Events:
        """Wait for real, as ``select`` of the platform's selector does."""
        return super().select(timeout)


@dataclass(slots=True, frozen=True)
class _Job:
    """Blocking work in a thread (or done already), and the future its result is owed to."""

    name: str
    work: concurrent.futures.Future[Any]
    future: asyncio.Future[Any]

    def deliver(self) -> None:
        if self.future.done():  # cancelled meanwhile
            return
        if self.work.cancelled():
            self.future.cancel()
        elif (error := self.work.exception()) is not None:
            self.future.set_exception(error)
        else:
            self.future.set_result(self.work.result())


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An event loop whose time jumps to the next timer as soon as nothing is left to do at the present time.

    Sockets, pipes, files, threads and signals are real.  Time stands still while a callback is ready, a file descriptor
    has an event, an executor job runs, or somebody is within :meth:`hold`.  Results of executor jobs arrive in order
    of submission, each when all else is quiet, so that a program whose threads race still runs the same way each time.
    A job that was submitted always runs: cancelling its future only drops the result, and the clock waits for it.

    Args:
        start: initial time, in s, at least 0 and below `CLOCK_LIMIT_S`.
        hold_timeout: real seconds to wait for one job or hold before `HoldTimeout`: no virtual timeout can see a real hang.
        inline: run jobs in the loop's thread as they are submitted: quickest for jobs that do next to nothing.
        external_io: expect peers outside this loop: wait for them for real when nothing else is left, instead of
            raising `VirtualDeadlock`, and look at sockets now and then while callbacks are ready.
        io_grace: with `external_io`, real seconds to wait for a socket before each jump of the clock.

    Raises:
        ValueError: for a start outside the clock's range.
    """

    # What this class needs of asyncio's internals; tests/clock checks the names on every supported Python.
    _ready: collections.deque[asyncio.Handle]
    _scheduled: list[asyncio.TimerHandle]
    _clock_resolution: float
    _default_executor: concurrent.futures.Executor | None
    _executor_shutdown_called: bool
    if TYPE_CHECKING:

        def _check_closed(self) -> None: ...
        def _check_default_executor(self) -> None: ...
        def _write_to_self(self) -> None: ...
        def _read_from_self(self) -> None: ...

    def __init__(
        self,
        *,
        start: float = 0.0,
        hold_timeout: float = 60.0,
        inline: bool = False,
        external_io: bool = False,
        io_grace: float = 0.0,
    ) -> None:
        in_range = 0 <= start < CLOCK_LIMIT_S
        self._now_ns = round(start * 1e9) if in_range else 0
        self._hold_timeout = hold_timeout
        self._inline = inline
        self._external_io = external_io
        self._io_grace = io_grace
        self._jobs: collections.deque[_Job] = collections.deque()
        self._holds: set[object] = set()
        self._waiting_since: float | None = None  # real time
        self._gave_up = False
        self._spins = 0
        self._hooked = _HookedSelector(self._select)
        super().__init__(self._hooked)
        self._clock_resolution = math.ulp(self.time())
        if not in_range:
            self.close()  # only a loop that was made can be closed, and one that is not closed warns
            raise ValueError(
                f"virtual time cannot start at {start!r} s: it must be in [0, {CLOCK_LIMIT_S:g}) s, where asyncio "
                f"still resolves 1 ns; keep wall-clock time as a separate offset"
            )

    # The clock

    def time_ns(self) -> int:
        """Virtual time in ns."""
        return self._now_ns

    def time(self) -> float:
        """Virtual time in s: the float nearest to `time_ns` / 1e9."""
        return self._now_ns / 1e9

    def call_at(
        self,
        when: float,
        callback: Callable[[Unpack[Ts]], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        """As asyncio's, on a grid of 1 ns, so that times equal but for float rounding are equal.

        A time that lies ahead, be it by 1e-17 s, is at least 1 ns ahead: who finds himself woken a rounding error
        early and asks again (anyio's deadlines do) must not do so for ever.
        """
        if math.isfinite(when):
            grid_ns = round(when * 1e9)
            if grid_ns <= self._now_ns and when > self.time():
                grid_ns = self._now_ns + 1
            when = grid_ns / 1e9
        return super().call_at(when, callback, *args, context=context)

    @contextlib.contextmanager
    def hold(self) -> Generator[None]:
        """Let time stand still while entered.  May be left in another thread, after its ``call_soon_threadsafe``."""
        token = object()
        self._holds.add(token)
        try:
            yield
        finally:
            self._waiting_since = None
            self._holds.discard(token)
            self._write_to_self()

    # Blocking work

    def run_in_executor(
        self,
        executor: concurrent.futures.Executor | None,
        func: Callable[[Unpack[Ts]], T],
        *args: *Ts,
    ) -> asyncio.Future[T]:
        """As asyncio's; takes no virtual time."""
        job = self._submit(executor, func, *args)
        self._jobs.append(job)
        return job.future

    def run_blocking(self, cost_s: float, fn: Callable[[Unpack[Ts]], T], *args: *Ts) -> asyncio.Future[T]:
        """Start `fn` in a thread now; its result arrives exactly `cost_s` of virtual time later."""
        check_cost(cost_s)
        job = self._submit(None, fn, *args)
        self.call_at((self._now_ns + round(cost_s * 1e9)) / 1e9, self._jobs.append, job)
        return job.future

    def _submit(
        self,
        executor: concurrent.futures.Executor | None,
        fn: Callable[[Unpack[Ts]], T],
        *args: *Ts,
    ) -> _Job:
        self._check_closed()
        name = getattr(fn, "__qualname__", repr(fn))
        if self._inline:
            return _Job(name, _run_inline(fn, *args), self.create_future())
        if executor is None:
            self._check_default_executor()
            executor = self._default_executor
            if executor is None:
                executor = concurrent.futures.ThreadPoolExecutor(thread_name_prefix="asyncio")
                self._default_executor = executor
        work = executor.submit(fn, *args)
        work.add_done_callback(lambda _: self._write_to_self())
        return _Job(name, work, self.create_future())

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        """Join the default executor's threads with the clock held; `hold_timeout` limits it, not `timeout`.

        asyncio's own waits for them with a bare thread and a (here: virtual) timeout.
        """
        self._executor_shutdown_called = True
        executor = self._default_executor
        if executor is None:
            return
        if self._gave_up:  # a thread hangs: that was reported already
            executor.shutdown(wait=False, cancel_futures=True)
            return
        joined = self.create_future()

        def join() -> None:
            executor.shutdown(wait=True)
            with contextlib.suppress(RuntimeError):  # the loop was closed: nobody waits
                self.call_soon_threadsafe(lambda: joined.done() or joined.set_result(None))

        with self.hold():
            threading.Thread(target=join, name="scanhsi-join-executor", daemon=True).start()
            await joined

    # What asyncio takes for waiting

    def _select(self, timeout: float | None) -> Events:
        """One step of waiting: events, one job's result, or a jump of the clock.

        asyncio gives a timeout of 0 when callbacks or timers are due or the loop stops, None when there is no timer.
        """
        if self._ready:
            return self._glance()
        events = self._hooked.poll(0)
        if events or timeout == 0:
            return events
        if self._jobs:
            return self._await_job()
        if self._holds:
            return self._wait("something within hold()", self._holds.clear)
        if self._ready:  # from a thread that let go of its hold just now
            return []
        when = self._scheduled[0].when() if self._scheduled else math.inf
        if self._external_io:
            events = self._hooked.poll(self._io_grace if when < CLOCK_LIMIT_S else None)
            if events:
                return events
        self._jump(when)
        return []

    def _glance(self) -> Events:
        """Callbacks are ready: sockets must wait (their order would be chance), but signals are seen at last."""
        self._spins += 1
        if self._external_io and self._spins % _SPINS_PER_POLL == 0:
            return self._hooked.poll(0)
        if self._spins % _SPINS_PER_SIGNAL_CHECK == 0:
            self._read_from_self()
        return []

    def _await_job(self) -> Events:
        job = self._jobs[0]
        if not job.work.done():
            return self._wait(f"job {job.name}", self._jobs.popleft)
        self._jobs.popleft()
        self._waiting_since = None
        job.deliver()
        return []

    def _wait(self, what: str, give_up: Callable[[], object]) -> Events:
        """Wait for real.  After a timeout, `give_up` lets the cleanup that follows run without waiting again."""
        now = time.monotonic()
        if self._waiting_since is None:
            self._waiting_since = now
        remaining = self._waiting_since + self._hold_timeout - now
        if remaining > 0:
            return self._hooked.poll(min(remaining, 3600.0))
        give_up()
        self._waiting_since = None
        self._gave_up = True
        raise HoldTimeout(
            f"virtual time {self.time()} s: {what} did not end within {self._hold_timeout:g} s of real time; is it hung? "
            f"A worker that lives for ever belongs in a threading.Thread, slow work needs a larger hold_timeout"
        )

    def _jump(self, when: float) -> None:
        if when >= CLOCK_LIMIT_S:
            raise VirtualDeadlock(self._describe_deadlock())
        when_ns = round(when * 1e9)
        while when_ns / 1e9 < when:  # floats are coarser than 1 ns after some weeks
            when_ns += 1
        self._now_ns = max(when_ns, self._now_ns)
        # asyncio runs what is due before time() + this: exactly the timers of this instant, none of the next ns
        self._clock_resolution = math.ulp(self.time())
        self._waiting_since = None

    def _describe_deadlock(self) -> str:
        waiting = sorted(map(_describe_task, asyncio.all_tasks(self)))
        return (
            f"virtual time {self.time()} s: no callback, timer, job or hold is left that could wake the waiting tasks "
            f"(peers outside the loop need external_io=True): {'; '.join(waiting[:10]) or 'none'}"
        )


def check_cost(cost_s: float) -> None:
    """Refuse a modelled duration that the virtual clock cannot hold, in either kind of time."""
    if not 0 <= cost_s < CLOCK_LIMIT_S:
        raise ValueError(f"run_blocking: the cost must be in [0, {CLOCK_LIMIT_S:g}) s, not {cost_s!r}")


def _run_inline(fn: Callable[[Unpack[Ts]], T], *args: *Ts) -> concurrent.futures.Future[T]:
    work: concurrent.futures.Future[T] = concurrent.futures.Future()
    try:
        result = fn(*args)
    except Exception as error:
        work.set_exception(error)
    else:
        work.set_result(result)
    return work


def _describe_task(task: asyncio.Task[Any]) -> str:
    """Name of a suspended task and the line of its innermost coroutine."""
    coro: Any = task.get_coro()
    while hasattr(inner := getattr(coro, "cr_await", None), "cr_frame"):
        coro = inner
    frame = getattr(coro, "cr_frame", None)
    if frame is None:
        return f"{task.get_name()} ({coro!r})"
    return f"{task.get_name()} in {coro.__qualname__} ({frame.f_code.co_filename}:{frame.f_lineno})"

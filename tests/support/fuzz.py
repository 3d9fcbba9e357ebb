"""Cancel a program at every point where it can be cancelled, in virtual time.

A coroutine can only be cancelled between two callbacks of its loop.  In virtual time those come in the same order on
each run, so "cancel before callback i, for all i" visits every place, and a case that fails can be run again by itself::

    def test_scan_survives_cancellation() -> None:
        for outcome in cancel_everywhere(lambda: scan(devices := make_devices())):
            assert outcome.surfaced and not outcome.orphans and not outcome.unhandled, outcome

Only callbacks given to ``call_soon`` count (task steps, wake-ups, done-callbacks), from the first step of the main task
to its end.  Timers, arrivals of threads and file descriptors need no count of their own: they act through ``call_soon``.
"""

import asyncio
import gc
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextvars import Context
from dataclasses import dataclass
from typing import Any, Unpack

from scanhsi.clock import VirtualOptions, VirtualTimeLoop


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one run.

    Attributes:
        cancelled_before: the indices of callbacks before which the main task was to be cancelled.
        callbacks: how many callbacks ran until the main task ended; without cancellation, the number of cases.
        requested: how many cancellations were made; fewer than asked for if the main task ended earlier.
        surfaced: the main task ended as cancelled.  True is demanded whenever `requested` > 0.
        result: what the main task returned, or None.
        error: what it raised, other than CancelledError: also the loop's VirtualDeadlock and HoldTimeout.
        orphans: tasks still alive when the main task ended.
        unhandled: messages to the loop's exception handler ("Task exception was never retrieved", ...).
        ended_at_ns: virtual time of the end.
    """

    cancelled_before: tuple[int, ...]
    callbacks: int
    requested: int
    surfaced: bool
    result: object
    error: BaseException | None
    orphans: tuple[str, ...]
    unhandled: tuple[str, ...]
    ended_at_ns: int


class _FuzzLoop(VirtualTimeLoop):
    """Counts the callbacks that it runs, and cancels `target` before some."""

    target: asyncio.Task[Any] | None = None
    callbacks = 0
    requested = 0
    cancel_before: tuple[int, ...] = ()

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Context | None = None) -> asyncio.Handle:
        return super().call_soon(self._run_counted, callback, args, context=context)

    def _run_counted(self, callback: Callable[..., object], args: tuple[Any, ...]) -> None:
        if self.target is not None and not self.target.done():
            index, self.callbacks = self.callbacks, self.callbacks + 1
            if index in self.cancel_before:
                self.requested += self.target.cancel()
        callback(*args)


def run_with_cancel_before(
    main_factory: Callable[[], Coroutine[Any, Any, object]],
    callback_index: int | None,
    *,
    again_after: int | None = None,
    **virtual_options: Unpack[VirtualOptions],
) -> Outcome:
    """Run ``main_factory()`` in virtual time and cancel it right before the callback with the given index.

    Args:
        main_factory: makes the coroutine, and all that it works on, anew for each run.  It must be deterministic.
        callback_index: from 0 (before the main task's first step); None cancels nothing, to count the callbacks.
        again_after: cancel a second time, that many callbacks after the first.
        virtual_options: arguments of `VirtualTimeLoop`.

    The main task's exceptions are in the outcome, not raised; KeyboardInterrupt and SystemExit are raised.  What the
    end of the loop adds (orphans are cancelled by the runner, as in ``asyncio.run``) still counts as `unhandled`.
    """
    first = () if callback_index is None else (callback_index,)
    cancel_before = first + tuple(index + again_after for index in first if again_after is not None)
    unhandled: list[str] = []
    result: object = None
    error: BaseException | None = None
    loop = _FuzzLoop(**virtual_options)
    loop.cancel_before = cancel_before
    loop.set_exception_handler(lambda _, context: unhandled.append(_describe(context)))
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        task = runner.get_loop().create_task(main_factory(), name="main")
        loop.target = task
        try:
            result = loop.run_until_complete(task)
        except asyncio.CancelledError:
            pass
        except Exception as caught:
            error = caught
        orphans = tuple(sorted(repr(other) for other in asyncio.all_tasks(loop) if other is not task))
        surfaced, ended_at_ns = task.cancelled(), loop.time_ns()
        del task
        loop.target = None
        try:
            runner.close()  # cancels the orphans, which may hang
        except Exception as caught:
            unhandled.append(repr(caught))
    gc.collect(1)  # a lost task complains when it is deleted; a full collection would take most of the time
    return Outcome(
        cancel_before,
        loop.callbacks,
        loop.requested,
        surfaced,
        result,
        error,
        orphans,
        tuple(unhandled),
        ended_at_ns,
    )


def cancel_everywhere(
    main_factory: Callable[[], Coroutine[Any, Any, object]],
    *,
    again_after: Sequence[int | None] = (None,),
    **virtual_options: Unpack[VirtualOptions],
) -> Iterator[Outcome]:
    """Yield the outcome of a cancellation before each callback in turn, for each distance in `again_after`.

    ``again_after=(None, 1, 2, 5, 20)`` is the thorough choice.  Ends when the program ends before it is cancelled.
    """
    for distance in again_after:
        index = 0
        while True:
            outcome = run_with_cancel_before(main_factory, index, again_after=distance, **virtual_options)
            if not outcome.requested:
                break
            yield outcome
            index += 1


def _describe(context: dict[str, Any]) -> str:
    exception = context.get("exception")
    return context["message"] + (f": {exception!r}" if exception is not None else "")

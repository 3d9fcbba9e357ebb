"""Leaving a scan: every cleanup step runs, whatever the others do and however often the scan is cancelled meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from scanhsi.devices.errors import DeviceTimeout, DeviceUnsafe, ScanhsiError
from scanhsi.log import get_logger

_log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class CleanupStep:
    """One thing to do on the way out.

    Attributes:
        what: For the error (``"stop the mirror"``).
        action: Does it.
        limit_s: How long it may take.
        after: Waits until the steps before it are done; else it runs beside them.
        device: What it is done to, for errors that do not say it.
        unsafe: What may be the case when it fails, where that can hurt (``"the mirror may be moving"``): told loudly.
        failed: Told its error.
    """

    what: str
    action: Callable[[], Awaitable[None]]
    limit_s: float
    after: bool = False
    device: str | None = None
    unsafe: str | None = None
    failed: Callable[[Exception], None] | None = None


async def clean_up(steps: list[CleanupStep]) -> list[Exception]:
    """Run all steps to their end, in a task of their own that no cancellation reaches; return what failed.

    A cancellation that comes meanwhile is raised when all are done: it is detected by the wait being cancelled, never by the state
    of the cleanup, so one that races the end of it is not swallowed either.
    """
    task = asyncio.ensure_future(_run_all(steps))
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError as error:
            cancelled = error
    failures = task.result()
    if cancelled is not None:
        tell_nevertheless(failures)
        raise cancelled
    return failures


def tell_nevertheless(failures: Sequence[BaseException]) -> None:
    """Log what failed where a cancellation takes the place of the error: a mirror that may still turn is nobody's secret."""
    for failure in failures:
        known = failure if isinstance(failure, ScanhsiError) else ScanhsiError("")
        _log.error(
            "failed while the scan was being cancelled",
            device=known.device,
            operation=known.operation,
            error=f"{type(failure).__name__}: {failure}",
        )


async def _run_all(steps: list[CleanupStep]) -> list[Exception]:
    failures: list[Exception] = []
    running: list[asyncio.Task[Exception | None]] = []
    for step in steps:
        if step.after:
            failures += await _results(running)
            running = []
        running.append(asyncio.ensure_future(_run_one(step)))
    return failures + await _results(running)


async def _results(running: list[asyncio.Task[Exception | None]]) -> list[Exception]:
    return [failure for task in running if (failure := await task) is not None]


async def _run_one(step: CleanupStep) -> Exception | None:
    try:
        async with asyncio.timeout(step.limit_s):
            await step.action()
    except TimeoutError:
        error = DeviceTimeout("it did not end.", device=step.device, operation=step.what, waited_s=step.limit_s)
        return _failed(step, error)
    except Exception as error:
        if isinstance(error, ScanhsiError) and error.operation is None:
            error.operation = step.what
        return _failed(step, error)
    return None


def _failed(step: CleanupStep, error: Exception) -> Exception:
    if step.unsafe is not None:
        error = _unsafe(step.unsafe, step, error)
    if step.failed is not None:
        step.failed(error)
    return error


def _unsafe(what: str, step: CleanupStep, cause: Exception) -> DeviceUnsafe:
    known = cause if isinstance(cause, ScanhsiError) else ScanhsiError(f"{type(cause).__name__}: {cause}")
    error = DeviceUnsafe(
        f"UNSAFE, {what}: {known.message}",
        device=known.device or step.device,
        operation=known.operation or step.what,
        waited_s=known.waited_s,
        hint="look at the instrument, and switch it off before you reach into it.",
    )
    error.__cause__ = cause
    _log.critical("unsafe", device=error.device, operation=error.operation, error=str(error))
    return error

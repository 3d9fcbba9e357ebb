"""Run one case of the fuzz, in virtual time, and keep what is needed to judge it."""

from __future__ import annotations

import asyncio
import gc
import os
import shutil
import tempfile
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import scanhsi
from scanhsi.clock import now_ns
from scanhsi.cube.destination import Destination
from scanhsi.cube.durable import LocalDestination
from scanhsi.engine import Progress, ScanPlan, ScanReport
from scanhsi.engine.recovery import let_go
from scanhsi.engine.steering import ScanControl
from scanhsi.testing.cases import Case
from scanhsi.testing.faults import NO_FAULTS, Faults
from scanhsi.testing.faulty_loop import FaultyLoop, wall_clock
from scanhsi.testing.faulty_storage import FaultyDestination, MemoryDestination
from scanhsi.testing.instrument import with_faults
from scanhsi.testing.snapshot import snapshot
from scanhsi.testing.witness import Witness

_A_WHILE_NS = 1_000_000_000


@dataclass(slots=True)
class Outcome:
    """What became of one case.

    Attributes:
        case: It.
        plan: Its plan.
        faults: Its faults, with what happened.
        witness: What truly happened.
        place: Where the cube is; None where nothing was stored.
        report: Of a scan that ended well.
        error: That it ended with, other than a cancellation.
        cancelled: The scan ended as cancelled.
        cancellations: How often it was told to.
        hung: It did not end by itself.
        stage: ``open``, ``scan``, ``close`` or ``over``: where the error came from.
        mirror_still, disarmed, dark: Of the devices, when the scan had ended and before they were closed.
        claimed: Most lines that were said to be stored while the process "lived".
        unhandled: What came to the loop's handler of exceptions.
        left: Tasks, threads, files and frames that were left.
        callbacks: Of the event loop.
        ended_s: Virtual time.
        resumed: Report of a second session, which took the lines that were left.
    """

    case: Case
    plan: ScanPlan
    faults: Faults
    witness: Witness
    place: Destination | None = None
    report: ScanReport | None = None
    error: BaseException | None = None
    cancelled: bool = False
    cancellations: int = 0
    hung: bool = False
    stage: str = "open"
    mirror_still: bool = True
    disarmed: bool = True
    dark: bool = True
    claimed: int = 0
    unhandled: list[str] = field(default_factory=list[str])
    left: list[str] = field(default_factory=list[str])
    callbacks: int = 0
    ended_s: float = 0.0
    over: bool = False
    resumed: ScanReport | None = None


def warm_up() -> None:
    """Let libraries open, once, what they keep for good."""
    case = Case(plan={"mode": "stepped", "lines": 2, "exposure_s": 0.01}, codec="lz4", target="disk")
    with run(case) as outcome:
        assert outcome.place is not None
        snapshot(outcome.place)


@contextmanager
def run(case: Case) -> Generator[Outcome]:
    """Run a case; its cube is there while entered."""
    folder = Path(tempfile.mkdtemp(prefix="scanhsi-fuzz-")) if case.target == "disk" else None
    try:
        yield _run(case, folder)
    finally:
        if folder is not None:
            shutil.rmtree(folder)


def _run(case: Case, folder: Path | None) -> Outcome:
    faults = Faults(case.faults)
    outcome = Outcome(case, case.scan_plan(), faults, Witness())
    before = _handles(), set(threading.enumerate())
    loop = FaultyLoop(faults)
    loop.set_exception_handler(lambda _, context: outcome.unhandled.append(_described(context)))
    with wall_clock(faults, loop), asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.get_loop()
        control = ScanControl()
        task = loop.create_task(_scan(case, outcome, control, loop, folder), name="scan")
        loop.watch(task, control)
        loop.call_at(case.deadline_s, _give_up, outcome, task)
        try:
            loop.run_until_complete(task)
        except asyncio.CancelledError:
            outcome.cancelled = True
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            outcome.error = error
        outcome.left += sorted(f"task {other.get_name()}" for other in asyncio.all_tasks(loop) if other is not task)
        outcome.cancellations, outcome.callbacks, outcome.ended_s = loop.cancellations, loop.callbacks, loop.time()
        del task
    _look_what_is_left(outcome, *before)
    return outcome


async def _scan(case: Case, outcome: Outcome, control: ScanControl, loop: FaultyLoop, folder: Path | None) -> None:
    config = with_faults(case.instrument(), outcome.faults, outcome.witness)
    outcome.place = _place(case, folder)
    destination = None
    if outcome.place is not None:
        destination = FaultyDestination(
            outcome.place, outcome.faults, sleep=loop.job_takes, on_end=lambda: setattr(outcome, "over", True)
        )

    def told(progress: Progress) -> None:
        if not outcome.over:
            outcome.claimed = max(outcome.claimed, progress.stored)

    async with scanhsi.open_instrument(config) as hsi:
        outcome.stage = "scan"
        try:
            outcome.report = await hsi.scan(outcome.plan, destination, on_progress=told, control=control)  # pyright: ignore[reportArgumentType] destinations pass through
        finally:
            now = now_ns()
            outcome.mirror_still = outcome.witness.still(now, now + _A_WHILE_NS)
            outcome.disarmed = not outcome.witness.armed
            outcome.dark = hsi.instrument.light is None or hsi.instrument.light.level == 0
        outcome.stage = "close"
    outcome.stage = "over"


def resume(outcome: Outcome) -> None:
    """Finish the cube of an interrupted scan in another session, in which nothing goes wrong; time and truth go on.

    Raises:
        Exception: It cannot be finished: whatever came out of the session.
    """
    place = outcome.place
    assert place is not None
    place.unlock()  # nobody holds the lock of a process that is gone
    faults = Faults(NO_FAULTS)
    loop = FaultyLoop(faults, start=outcome.ended_s + 1.0)
    config = with_faults(outcome.case.instrument(), faults, outcome.witness)

    async def finish() -> ScanReport:
        async with scanhsi.open_instrument(config) as hsi, asyncio.timeout(outcome.case.deadline_s):
            return await hsi.resume(place)  # pyright: ignore[reportArgumentType] destinations pass through

    with wall_clock(faults, loop), asyncio.Runner(loop_factory=lambda: loop) as runner:
        outcome.resumed = runner.run(finish())


def _place(case: Case, folder: Path | None) -> Destination | None:
    if folder is not None:
        return LocalDestination(folder / "cube.zarr")
    return MemoryDestination() if case.target == "memory" else None


def _give_up(outcome: Outcome, task: asyncio.Task[Any]) -> None:
    if not task.done():
        outcome.hung = True
        task.cancel()


def _described(context: dict[str, Any]) -> str:
    error = context.get("exception")
    return context["message"] + (f": {error!r}" if error is not None else "")


def _look_what_is_left(outcome: Outcome, handles: int, threads: set[threading.Thread]) -> None:
    if outcome.witness.alive:
        let_go(() if outcome.error is None else (outcome.error,))  # so that it holds on to nothing
        gc.collect()
    if outcome.witness.alive:
        outcome.left.append(f"{outcome.witness.alive} frames")
    outcome.left += [f"thread {thread.name}" for thread in set(threading.enumerate()) - threads if not _known(thread)]
    if (more := _handles() - handles) > 0:
        outcome.left.append(f"{more} file handles")


def _known(thread: threading.Thread) -> bool:
    """Threads of libraries, which stay for good."""
    return thread.daemon or thread.name.startswith("zarr")


def _handles() -> int:
    return len(os.listdir("/proc/self/fd"))

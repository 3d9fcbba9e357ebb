"""What takes a while: scans, calibrations, benchmarks. One at a time; the last ones are remembered."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass, field, is_dataclass
from datetime import UTC, datetime
from enum import StrEnum, unique
from typing import Any, Final, cast
from uuid import uuid4

from scanhsi.devices.errors import ScanFailed, ScanhsiError
from scanhsi.engine import ScanControl
from scanhsi.service.refusals import Conflict, NoSuch

KEPT: Final = 100


@unique
class JobState(StrEnum):
    """How far a job is."""

    RUNNING = "running"
    WAITING = "waiting"
    """For a person, who is asked for something in ``prompt``, and confirms it."""
    PAUSED = "paused"
    DONE = "done"
    STOPPED = "stopped"
    """Ended early because it was asked to; what was taken is kept."""
    FAILED = "failed"
    CANCELLED = "cancelled"


ENDED: Final = frozenset({JobState.DONE, JobState.STOPPED, JobState.FAILED, JobState.CANCELLED})


@dataclass(slots=True)
class Job:
    """One job.

    Attributes:
        id: Names it.
        kind: ``scan``, ``calibration``, ``auto-exposure``, ``benchmark``, ...
        title: For people.
        created: ISO 8601, UTC.
        ended: The same.
        state: How far it is.
        prompt: What a person is asked to do.
        message: What is being done.
        progress: Of a scan: lines, efficiency, time left, ...
        output: Name of what it makes, in the data folder.
        request: What was asked for.
        result: What came of it.
        error: What went wrong.
        control: How a scan is paused, and ended politely; None for other jobs.
        confirmed: Set when a person has done what was asked.
        task: That runs it.
    """

    kind: str
    title: str
    output: str | None = None
    request: dict[str, Any] = field(default_factory=dict[str, Any])
    id: str = field(default_factory=lambda: uuid4().hex[:12])
    created: str = field(default_factory=lambda: _now())
    ended: str | None = None
    state: JobState = JobState.RUNNING
    prompt: str | None = None
    message: str | None = None
    progress: dict[str, Any] | None = None
    result: dict[str, Any] | None = None
    error: BaseException | None = None
    confirmed: asyncio.Event = field(default_factory=asyncio.Event)
    control: ScanControl | None = None
    task: asyncio.Task[None] | None = None
    _news: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self.state in ENDED

    async def settled(self, within_s: float) -> None:
        """Wait until it is over or waits for a person, but not longer than so."""
        if within_s and not self.over and self.state is not JobState.WAITING:
            waiting = asyncio.ensure_future(self._news.wait())
            await asyncio.wait([waiting], timeout=within_s)
            waiting.cancel()

    def tell_waiting(self) -> None:
        """Whoever waits for news gets it now."""
        self._news.set()
        self._news = asyncio.Event()


class Jobs:
    """All jobs of a station.

    Args:
        changed: Called with a job that changed.
    """

    def __init__(self, changed: Callable[[Job], None]) -> None:
        self._changed = changed
        self._jobs: dict[str, Job] = {}

    @property
    def current(self) -> Job | None:
        """The one under way."""
        return next((job for job in self._jobs.values() if not job.over), None)

    def all(self) -> list[Job]:
        """The youngest first."""
        return list(self._jobs.values())[::-1]

    def get(self, id: str) -> Job:
        """One of them.

        Raises:
            NoSuch: There is none.
        """
        if id not in self._jobs:
            raise NoSuch(f"there is no job {id}.", hint="GET /api/v1/jobs")
        return self._jobs[id]

    def start(self, job: Job, work: Callable[[Job], Awaitable[dict[str, Any]]]) -> Job:
        """Run it in a task of its own."""
        self._jobs[job.id] = job
        for id in [id for id, old in self._jobs.items() if old.over][: max(0, len(self._jobs) - KEPT)]:
            del self._jobs[id]
        job.task = asyncio.get_running_loop().create_task(self._run(job, work), name=f"job {job.id}")
        self._changed(job)
        return job

    async def _run(self, job: Job, work: Callable[[Job], Awaitable[dict[str, Any]]]) -> None:
        try:
            job.result = await work(job)
            job.state = JobState.STOPPED if job.control is not None and job.control.stop.is_set() else JobState.DONE
        except asyncio.CancelledError:
            job.state = JobState.CANCELLED
        except ScanFailed as error:
            job.error, job.state = error, JobState.FAILED
        except Exception as error:  # a job that fails, also by a bug, is told of where it is asked for
            job.error, job.state = error, JobState.FAILED
            if not isinstance(error, ScanhsiError):
                asyncio.get_running_loop().call_exception_handler({"message": f"job {job.id}", "exception": error})
        finally:
            job.prompt, job.ended = None, _now()
            job.tell_waiting()
            self._changed(job)

    async def ask(self, job: Job, request: str) -> None:
        """Have a person do something; return when they have confirmed it."""
        job.confirmed.clear()
        job.state, job.prompt = JobState.WAITING, request
        job.tell_waiting()
        self._changed(job)
        await job.confirmed.wait()
        job.state, job.prompt = JobState.RUNNING, None
        self._changed(job)

    def tell(self, job: Job, message: str) -> None:
        """Say what is being done."""
        job.message = message
        self._changed(job)

    def confirm(self, id: str) -> Job:
        """What was asked is done.

        Raises:
            Conflict: Nothing was asked.
        """
        job = self.get(id)
        if job.state is not JobState.WAITING:
            raise Conflict(f"job {id} is {job.state}, it waits for nobody.")
        job.confirmed.set()
        return job

    def pause(self, id: str) -> Job:
        """Hold a scan after the line under way.

        Raises:
            Conflict: It is over, or cannot be paused.
        """
        job = self._under_way(id)
        if job.control is None or job.state is not JobState.RUNNING:
            raise Conflict(f"job {id}, a {job.kind} that is {job.state}, cannot be paused.")
        job.control.pause()
        job.state = JobState.PAUSED
        self._changed(job)
        return job

    def resume(self, id: str) -> Job:
        """Go on with a scan that was paused.

        Raises:
            Conflict: It is not paused.
        """
        job = self._under_way(id)
        if job.control is None or job.state is not JobState.PAUSED:
            raise Conflict(f"job {id} is {job.state}, not paused.")
        job.state = JobState.RUNNING
        job.control.go_on()
        self._changed(job)
        return job

    def finish(self, id: str) -> Job:
        """End a job politely: the line under way is finished, the cube closed. One that knows no such end is cancelled."""
        job = self._under_way(id)
        if job.control is None:
            return self.cancel(id)
        job.control.stop.set()
        if job.state is JobState.PAUSED:
            self.resume(id)
        return job

    def cancel(self, id: str) -> Job:
        """End a job at once."""
        job = self._under_way(id)
        assert job.task is not None
        job.task.cancel()
        return job

    def _under_way(self, id: str) -> Job:
        job = self.get(id)
        if job.over:
            raise Conflict(f"job {id} is over: {job.state}.")
        return job


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def plain(value: Any) -> Any:
    """As JSON can hold it: dataclasses become objects, numbers that it lacks become null."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in cast("dict[Any, Any]", value).items()}
    if isinstance(value, list | tuple | frozenset | set):
        return [plain(item) for item in cast("list[Any]", value)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, int | bool) else str(value)

"""Writers that may be killed at any moment: processes that write a cube, and what they had said to be safe when they died.

``python victims.py`` is the server: it imports everything once, then forks a victim for each job, so that none spends its short
life on imports. `Victims` talks to it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

SERVER = __name__ == "__main__"
if SERVER:
    sys.path.insert(0, str(Path(__file__).parents[1]))

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.places import destination_of
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from support.cubes import feed
from support.scans import scan_cube

MISSING = {2: "lost", 9: "late", 10: "late"}
"""Lines that are lost in every scan here."""

LINES_PER_SHARD = 6


@dataclass(frozen=True, slots=True)
class Job:
    """What a victim is to write.

    Attributes:
        path: Of the cube, or its URL.
        lines: Of it.
        codec: How pixels are stored.
        durability: When.
        resume: Whether the cube is there and to be gone on with.
        flush_every: Lines after which a pause is made, as a scan that was interrupted does; never, if 0.
        spool: Folder that a cube at a URL is written through; none, if empty.
        fsync: Whether the disk is really asked to sync. Process death does not tell the difference, but it takes the time.
        scan: Whether it is a whole scan with simulated devices, see `support.scans`, instead of a writer alone.
        virtual: Whether that runs in virtual time.
    """

    path: str
    lines: int = 40
    codec: str = "lz4"
    durability: str = "every shard"
    resume: bool = False
    flush_every: int = 0
    fsync: bool = False
    spool: str = ""
    scan: bool = False
    virtual: bool = False

    @property
    def spec(self) -> CubeSpec:
        return CubeSpec(self.lines, 24, 60, "uint16", 12, attributes={"plan": {"mode": "stepped"}})


async def write(job: Job, tell: Any = lambda _: None) -> None:
    """Do a job; ``tell`` is called with every line that was said to be safe."""
    if job.scan:
        await scan_cube(Path(job.path), tell, lines=job.lines, resume=job.resume)
        return
    records = LineRecords(job.lines)
    place = destination_of(job.path, spool=job.spool or None)
    if job.resume:
        writer = CubeWriter.resume(place, job.spec, durability=job.durability)  # pyright: ignore[reportArgumentType]
        first = writer.next_line
    else:
        options: dict[str, Any] = {"codec": job.codec, "durability": job.durability}
        writer, first = CubeWriter(place, job.spec, lines_per_shard=LINES_PER_SHARD, slots=2, **options), 0
    await writer.open(records)
    try:
        for line in range(first, job.lines):
            for safe in await feed(writer, job.spec, records, range(line, line + 1), MISSING):
                if safe:
                    tell(safe[-1])
            if job.flush_every and line % job.flush_every == job.flush_every - 1 and (safe := await writer.flush()):
                tell(safe[-1])
        if safe := await writer.flush():
            tell(safe[-1])
    finally:
        await writer.close()


@dataclass(frozen=True, slots=True)
class End:
    """How a victim ended.

    Attributes:
        safe: Lines that it had said to be safe: all before this one.
        killed: Whether it was killed before it was done.
        error: What it raised, if it did.
    """

    safe: int
    killed: bool
    error: str | None


class Victims:
    """Starts victims; a context manager."""

    def __init__(self) -> None:
        self._server = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def start(self, job: Job) -> int:
        """Start a victim, which waits for `go`; returns its process id."""
        self._tell(asdict(job))
        return self._ask()["pid"]

    def go(self) -> None:
        """Let it write."""
        self._tell({})

    def end(self) -> End:
        """Wait until it is done, or dead."""
        return End(**self._ask())

    def _tell(self, value: dict[str, Any]) -> None:
        assert self._server.stdin is not None
        self._server.stdin.write(json.dumps(value) + "\n")
        self._server.stdin.flush()

    def _ask(self) -> dict[str, Any]:
        assert self._server.stdout is not None
        return json.loads(self._server.stdout.readline())

    def __enter__(self) -> Victims:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._server.stdin is not None
        self._server.stdin.close()
        self._server.wait(timeout=30)
        assert self._server.stdout is not None
        self._server.stdout.close()


def serve() -> None:
    """One job after another, until stdin closes."""
    for line in sys.stdin:
        job = Job(**json.loads(line))
        gate, open_gate = os.pipe()
        told, tell = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(told)
            os.close(open_gate)
            victim(job, gate, tell)
        os.close(tell)
        os.close(gate)
        answer({"pid": pid})
        sys.stdin.readline()
        os.close(open_gate)
        with os.fdopen(told) as said:
            words = said.read().splitlines()
        _, code = os.waitpid(pid, 0)
        safe = [int(word) for word in words if word.isdecimal()]
        errors = [word for word in words if word.startswith("error")]
        killed = os.WIFSIGNALED(code) and os.WTERMSIG(code) == signal.SIGKILL
        answer({"safe": safe[-1] + 1 if safe else 0, "killed": killed, "error": errors[0] if errors else None})


def victim(job: Job, gate: int, tell: int) -> None:
    """Write, then end without any cleaning up."""
    if not job.fsync:
        os.fsync = os.fdatasync = lambda fd: None
    os.read(gate, 1)
    try:
        clock.run(write(job, lambda line: os.write(tell, f"{line}\n".encode())), virtual=job.virtual)
    except Exception as error:
        os.write(tell, f"error {type(error).__name__}: {error}\n".encode())
    finally:
        os._exit(0)


def answer(value: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


if SERVER:
    serve()

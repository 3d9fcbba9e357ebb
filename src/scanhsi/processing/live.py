"""Processing beside a scan, in a process of its own: see `scanhsi.processing.follow`.

A process, not a thread: it shares neither interpreter nor memory with the scan, it gives way to it where they want the same
processor, and if it dies the scan does not.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, Self

from scanhsi.clock import run_blocking
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.shards import Codec
from scanhsi.devices.errors import ConfigError, CubeExists
from scanhsi.engine.report import Processed
from scanhsi.log import get_logger
from scanhsi.processing.pipeline import Pipeline
from scanhsi.processing.signal import Signal
from scanhsi.processing.steps import Step

_WAIT_S: Final = 0.5
_log = get_logger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class LiveProcessing:
    """What is to be made of a cube while it is scanned.

    As in ``await hsi.scan(plan, "raw.zarr", process=LiveProcessing(steps, "reflectance.zarr"))``.

    Attributes:
        steps: What to do, in order.
        output: Folder of the new cube, which must not exist.
        codec: Of the new cube.
    """

    steps: Sequence[Step]
    output: str | Path
    codec: Codec = "lz4"

    def check(self, spec: CubeSpec | None, cube: str | Path | None) -> None:
        """Refuse what cannot be, before anything moves.

        Args:
            spec: Of the raw cube; None if there will be none.
            cube: Where it goes.

        Raises:
            CalibrationError: A step does not fit.
            CubeExists: The output is there.
            ConfigError: The raw cube goes where it cannot be read while it grows.
        """
        if spec is None or cube is None or "://" in str(cube):
            raise ConfigError(
                "lines are processed live from the raw cube as it grows on a local disk; "
                f"{'they are discarded here' if cube is None else f'{cube} is none'}.",
                hint="scan to a local folder, or run scanhsi process afterwards",
            )
        Pipeline(Signal.of_spec(spec), self.steps)
        if Path(self.output).exists():
            raise CubeExists(
                f"{self.output} exists already; nothing moved.", hint="another name, or move it away first"
            )

    @asynccontextmanager
    async def beside(self, spec: CubeSpec | None, cube: str | Path | None) -> AsyncGenerator[Following]:
        """The process beside a scan, which ends with it.

        Raises:
            CalibrationError, CubeExists, ConfigError: As `check`.
        """
        await run_blocking(0.0, self.check, spec, cube)
        assert cube is not None, "checked"
        following = await Following.start(self, cube)
        try:
            yield following
        finally:
            following.abandon()


class Following:
    """The process that follows a scan."""

    def __init__(self, live: LiveProcessing, process: subprocess.Popen[bytes], job: Path, said: IO[bytes]) -> None:
        self._live, self._process, self._job, self._said = live, process, job, said

    @classmethod
    async def start(cls, live: LiveProcessing, cube: str | Path) -> Self:
        """Start it; it waits for the cube."""
        return await run_blocking(0.0, cls._start, live, cube)

    @classmethod
    def _start(cls, live: LiveProcessing, cube: str | Path) -> Self:
        import cloudpickle  # of dask: it takes along what is defined in a script or a notebook

        descriptor, name = tempfile.mkstemp(prefix="scanhsi-live-", suffix=".pickle")
        with os.fdopen(descriptor, "wb") as file:
            cloudpickle.dump((str(cube), live), file)
        said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `abandon`
        command = [sys.executable, "-m", "scanhsi.processing.live_worker", name]
        # A session of its own: Ctrl-C is for the scan, which tells this one.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, start_new_session=True
        )
        return cls(live, process, Path(name), said)

    async def finish(self) -> Processed:
        """The scan is over: wait until the rest is made. What fails is told in the report and the log, never raised."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        while await run_blocking(0.0, self._running):
            pass
        report = await run_blocking(0.0, self._report)
        if report.error is not None:
            _log.error("live processing failed; the raw cube is whole", operation="process", error=report.error)
        return report

    def _running(self) -> bool:
        try:
            self._process.wait(_WAIT_S)
        except subprocess.TimeoutExpired:
            return True
        return False

    def _report(self) -> Processed:
        assert self._process.stdout is not None
        told = self._process.stdout.read().decode(errors="replace").splitlines()
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip().splitlines()
        self.abandon()
        result: dict[str, Any] = {}
        with suppress(ValueError, IndexError):
            result = json.loads(told[-1])
        if "lines" in result:
            return Processed(str(self._live.output), **result)
        why = result.get("error") or (said[-1] if said else f"it ended with exit status {self._process.returncode}")
        return Processed(str(self._live.output), error=f"{why} (scanhsi process --resume makes the rest)")

    def abandon(self) -> None:
        """End it where it is; what is made stays, and is not complete. Idempotent."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._said):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
        self._job.unlink(missing_ok=True)

"""The camera's twin as its parent sees it: starts `scanhsi_sim.twins.camera` in a process of its own, and talks to it.

    async with CameraTwin(CameraTwinSettings(scene="testpattern")) as twin:
        camera = ...  # the real driver, at twin.address
        print(await twin.stats())

Needs a private network namespace, libaravis and gcc. The process ends with the ``async with`` block, and by itself when its
parent dies (its standard input closes).
"""

import asyncio
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from scanhsi.devices.errors import DeviceLost, DeviceTimeout, DeviceUnavailable

_NAME = "camera twin"
_START_S = 30.0
_ANSWER_S = 5.0
_END_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTwinSettings:
    """How the camera's twin is set up.

    Attributes:
        scene: What it looks at: a name of `scanhsi_sim.scenes.SCENES`.
        seed: Of the scene and of the sensor's noise.
        mirror_file: Where the stepper's twin keeps the mirror's true position; None = the mirror stands still at `step`.
        step: See `mirror_file`.
        trigger_socket: Unix datagram socket that it makes for the stepper twin's trigger pulses; None = no Line1.
        genicam: GenICam description of another camera; None = ``mako.xml``.
    """

    scene: str = "testpattern"
    seed: int = 0
    mirror_file: Path | None = None
    step: int = 0
    trigger_socket: Path | None = None
    genicam: Path | None = None


@dataclass(slots=True)
class CameraTwin:
    """A running camera twin. All members are valid inside ``async with`` only."""

    settings: CameraTwinSettings = field(default_factory=CameraTwinSettings)
    address: str = "127.0.0.1"
    _process: asyncio.subprocess.Process | None = None
    _talking: asyncio.Lock = field(default_factory=asyncio.Lock)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._running().pid

    async def command(self, text: str) -> str:
        """Send one line, return the answer; see `scanhsi_sim.twins.camera`.

        Raises:
            ValueError: It does not know the command.
            DeviceLost: It has died.
            DeviceTimeout: It does not answer.
        """
        async with self._talking:
            process = self._running()
            if process.stdin is not None and process.returncode is None:
                process.stdin.write(text.encode() + b"\n")
            answer = await self._line(text, _ANSWER_S)
        if answer.startswith("error"):
            raise ValueError(answer)
        return answer

    async def stats(self) -> dict[str, Any]:
        """Counters since its start; times in us as [p50, p99, max]. See `scanhsi_sim.twins.camera.Twin.stats`."""
        return json.loads(await self.command("stats"))

    async def wait_ended(self) -> int:
        """Wait until its process has ended, for whatever reason; return the exit code."""
        return await self._running().wait()

    async def __aenter__(self) -> Self:
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "scanhsi_sim.twins.camera", *_arguments(self.settings)),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            await self._line("start", _START_S)
        except DeviceLost as error:
            await self._end()
            raise DeviceUnavailable("it does not start; see its message above.", device=_NAME) from error
        except BaseException:
            await self._end()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._end()

    async def _line(self, operation: str, limit_s: float) -> str:
        process = self._running()
        line = b""
        try:
            async with asyncio.timeout(limit_s):
                if process.stdout is not None:
                    line = await process.stdout.readline()
                if not line:
                    await process.wait()
        except TimeoutError:
            raise DeviceTimeout("no answer.", device=_NAME, operation=operation, waited_s=limit_s) from None
        if not line:
            raise DeviceLost(f"it (pid {process.pid}) has ended with code {process.returncode}.", device=_NAME)
        return line.decode().strip()

    async def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        if process.stdin:
            process.stdin.close()  # it leaves when its input ends
        try:
            async with asyncio.timeout(_END_S):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()

    def _running(self) -> asyncio.subprocess.Process:
        if self._process is None:
            raise RuntimeError("the camera twin is not running: use it in `async with`")
        return self._process


def _arguments(settings: CameraTwinSettings) -> list[str]:
    arguments = [f"--scene={settings.scene}", f"--seed={settings.seed}", f"--step={settings.step}"]
    if settings.mirror_file is not None:
        arguments.append(f"--mirror={settings.mirror_file}")
    if settings.trigger_socket is not None:
        arguments.append(f"--trigger-socket={settings.trigger_socket}")
    if settings.genicam is not None:
        arguments.append(f"--genicam={settings.genicam}")
    return arguments

"""The stepper's twin: the real firmware in an AVR emulator behind a pseudo terminal, in a process of its own.

    async with StepperTwin() as twin:
        actuator = ...  # the real driver, at twin.port
        print(await twin.stats())

Needs the Debian packages libsimavr-dev, libelf-dev and gcc. The process ends with the ``async with`` block, and by itself when
its parent dies (its standard input closes).
"""

from __future__ import annotations

import asyncio
import shutil
import tempfile
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from scanhsi.devices.errors import DeviceLost, DeviceTimeout, DeviceUnavailable
from scanhsi_sim.twins.mirror import MirrorState
from scanhsi_sim.twins.stepper_build import build_bench, firmware_elf

CPU_HZ = 16_000_000
_NAME = "stepper twin"
_START_S = 10.0
_ANSWER_S = 5.0
_END_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StepperTwinSettings:
    """How the emulated stepper is set up.

    Attributes:
        speed: Simulated seconds per second; 0 = as fast as it goes.
        start_step: Where the mirror stands, in steps from the home edge; the firmware does not know.
        window_low_step: Lowest position at which the home switch is closed. The default puts the edge that homing downwards
            finds at 0; for homing upwards take 0.
        window_steps: Width of the home index; it comes again every 19,200 steps.
        auto_reset_s: Opening the port resets the controller, which then stays in its bootloader for so long (a real Uno:
            1.6 s); None = it does not.
        seed: Of the injected noise.
        firmware: ELF file for the ATmega328P; None = the one of the stepper driver.
        grbl_shield: The firmware has the pins of GRBL; its X axis turns the mirror.
        trigger_socket: Unix datagram socket that gets 24 bytes for each trigger pulse at once: number, position in steps,
            CLOCK_MONOTONIC in ns (of the pulse; it arrives up to 0.2 ms later), each a little-endian int64. A late reader gets
            all pulses in order; pulses while nobody listens are only counted.
        trigger_lines: Also keep each trigger in `StepperTwin.triggers`.
    """

    speed: float = 1.0
    start_step: int = 1234
    window_low_step: int = -39
    window_steps: int = 40
    auto_reset_s: float | None = None
    seed: int = 1
    firmware: Path | None = None
    grbl_shield: bool = False
    trigger_socket: Path | None = None
    trigger_lines: bool = False


@dataclass(frozen=True, slots=True)
class TriggerLine:
    """One trigger pulse as the bench saw it: its number from 1, the mirror's position, the CPU cycle (16 MHz)."""

    number: int
    position: int
    cycle: int


@dataclass(slots=True)
class StepperTwin:
    """A running bench. All members are valid inside ``async with`` only.

    Attributes:
        settings: How it is set up.
        port: Path to open as a serial port; stays the same over `command` ``unplug`` and ``plug``.
        mirror_file: For `scanhsi_sim.twins.mirror.MirrorState.open`.
        triggers: Pulses since the start, with ``trigger_lines``.
    """

    settings: StepperTwinSettings = field(default_factory=StepperTwinSettings)
    triggers: list[TriggerLine] = field(default_factory=list[TriggerLine])
    _directory: Path | None = None
    _process: asyncio.subprocess.Process | None = None
    _reader: asyncio.Task[None] | None = None
    _answers: deque[asyncio.Future[str]] = field(default_factory=deque[asyncio.Future[str]])

    @property
    def directory(self) -> Path:
        """Private folder of this twin; removed at the end."""
        if self._directory is None:
            raise RuntimeError("the stepper twin is not running: use it in `async with`")
        return self._directory

    @property
    def port(self) -> str:
        """Path to open as a serial port."""
        return str(self.directory / "port")

    @property
    def mirror_file(self) -> Path:
        """Memory-mapped state of the mirror."""
        return self.directory / "mirror"

    @property
    def pid(self) -> int:
        """Process id of the bench."""
        return self._running().pid

    def open_mirror(self) -> MirrorState:
        """A reader of the mirror's true position. The caller closes it."""
        return MirrorState.open(self.mirror_file)

    async def command(self, text: str) -> str:
        """Send one line to the bench; return its answer without the ``OK``.

        Commands: ``stats``, ``stats-reset``, ``mirror N`` (turn it by hand), ``lose N`` (the motor misses the Nth step from now),
        ``noise GARBLE DROP`` (each per 10,000 bytes, both ways), ``flip rx|tx N``, ``unplug``, ``plug``, ``reset``,
        ``triggers on|off``, ``speed F``.

        Raises:
            ValueError: The bench does not know the command.
            DeviceLost: The bench has died.
        """
        process = self._running()
        if process.stdin is None or (self._reader and self._reader.done()):
            raise _died(process)
        answer = asyncio.get_running_loop().create_future()
        self._answers.append(answer)
        process.stdin.write(text.encode() + b"\n")
        try:
            async with asyncio.timeout(_ANSWER_S):
                line = await answer
        except TimeoutError:
            raise DeviceTimeout("no answer.", device=_NAME, operation=text, waited_s=_ANSWER_S) from None
        if line.startswith("ERR"):
            raise ValueError(f"{text!r}: {line}")
        return line.removeprefix("OK").strip()

    async def stats(self) -> dict[str, int]:
        """Counters of pins, mirror and serial line; cycles are of the 16 MHz CPU, -1 = none yet."""
        words = (await self.command("stats")).split()
        return {name: int(value) for name, _, value in (word.partition("=") for word in words)}

    async def wait_ended(self) -> int:
        """Wait until the bench's process has ended, for whatever reason; return its exit code."""
        return await self._running().wait()

    async def __aenter__(self) -> Self:
        program = await asyncio.to_thread(build_bench)
        self._directory = Path(tempfile.mkdtemp(prefix="scanhsi-stepper-"))
        try:
            await self._start(program)
        except BaseException:
            await self._end()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._end()

    async def _start(self, program: Path) -> None:
        self._process = await asyncio.create_subprocess_exec(
            str(program),
            *_arguments(self.settings, self.port, self.mirror_file),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        ready = asyncio.get_running_loop().create_future()
        self._answers.append(ready)  # the bench opens with "PORT name"
        self._reader = asyncio.create_task(self._read(self._process), name=_NAME)
        try:
            async with asyncio.timeout(_START_S):
                await ready
        except TimeoutError:
            raise DeviceTimeout("the emulator does not start.", device=_NAME, waited_s=_START_S) from None
        except DeviceLost:
            raise DeviceUnavailable("the emulator does not start; see its message above.", device=_NAME) from None

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        """Sort the bench's lines: trigger pulses, and answers in the order of the commands."""
        if process.stdout is None:
            return
        while line := (await process.stdout.readline()).decode().strip():
            if line.startswith("TRIG "):
                self.triggers.append(TriggerLine(*(int(word) for word in line.split()[1:])))
            elif self._answers:
                answer = self._answers.popleft()
                if not answer.done():
                    answer.set_result(line)
        await process.wait()
        while self._answers:
            answer = self._answers.popleft()
            if not answer.done():
                answer.set_exception(_died(process))

    async def _end(self) -> None:
        process, reader = self._process, self._reader
        if process and process.stdin:
            process.stdin.close()  # the bench leaves when its input ends
        if process and process.returncode is None:
            try:
                async with asyncio.timeout(_END_S):
                    await process.wait()
            except TimeoutError:
                process.kill()
                await process.wait()
        if reader:
            await reader
        if self._directory:
            shutil.rmtree(self._directory, ignore_errors=True)
        self._process = self._reader = self._directory = None

    def _running(self) -> asyncio.subprocess.Process:
        if self._process is None:
            raise RuntimeError("the stepper twin is not running: use it in `async with`")
        return self._process


def _died(process: asyncio.subprocess.Process) -> DeviceLost:
    return DeviceLost(f"the emulator (pid {process.pid}) has ended with code {process.returncode}.", device=_NAME)


def _arguments(settings: StepperTwinSettings, port: str, mirror_file: Path) -> list[str]:
    arguments = [
        f"--firmware={settings.firmware or firmware_elf()}",
        f"--link={port}",
        f"--mirror-file={mirror_file}",
        f"--speed={settings.speed}",
        f"--start={settings.start_step}",
        f"--window-low={settings.window_low_step}",
        f"--window-steps={settings.window_steps}",
        f"--seed={settings.seed}",
    ]
    if settings.auto_reset_s is not None:
        arguments.append(f"--auto-reset={round(settings.auto_reset_s * 1000)}")
    if settings.trigger_socket is not None:
        arguments.append(f"--trigger-socket={settings.trigger_socket}")
    if settings.grbl_shield:
        arguments.append("--grbl-shield")
    if settings.trigger_lines:
        arguments.append("--trigger-stream")
    return arguments

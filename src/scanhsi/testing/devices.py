"""What the suites for cameras, actuators and lights share: running a device, and what it must leave behind: nothing."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Generator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from scanhsi import clock
from scanhsi.devices import Actuator, Camera, Light
from scanhsi.devices.errors import DeviceError

D = TypeVar("D", Camera, Actuator, Light)
T = TypeVar("T")

_GONE_WITHIN_S = 10.0
_used: set[type] = set()


class DeviceConformance(Generic[D]):
    """Base of all suites.

    Attributes:
        virtual: Run in virtual time; for devices that wait through asyncio only (``Backend.virtual_time``).
        exclusive: A second object for the same device must be refused with `DeviceBusy` while the first is connected. False for
            a device that any number of programs may share.
        patience_s: Longest that one test may take, on the device's clock.
    """

    virtual: ClassVar[bool] = False
    exclusive: ClassVar[bool] = True
    patience_s: ClassVar[float] = 60.0

    def make(self) -> D:
        """A new device object, not connected, that uses the same device each time. The one method that a driver's author writes."""
        raise NotImplementedError("write `def make(self)`: it returns a new device object, not connected")

    def run(self, use: Callable[[D], Awaitable[T]], *, connected: bool = True) -> T:
        """Run a coroutine function with the device, connected, in a loop of its own; close the device, and look what is left."""

        async def main() -> T:
            device = self.make()
            try:
                async with asyncio.timeout(self.patience_s):
                    if connected:
                        await device.connect()
                    return await use(device)
            finally:
                await device.close()
                await self._no_tasks_are_left()

        first = type(self) not in _used  # a library may keep for good what its first use opens
        _used.add(type(self))
        with nullcontext() if first else nothing_is_left():
            return clock.run(main(), virtual=self.virtual)

    async def _no_tasks_are_left(self) -> None:
        await asyncio.sleep(0)
        left = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        assert not left, f"tasks go on after close(): {left}"


@contextmanager
def nothing_is_left() -> Generator[None]:
    """Check that threads and file handles of a device end with it."""
    threads, handles = set(threading.enumerate()), _handles()
    yield
    deadline = time.monotonic() + _GONE_WITHIN_S
    while True:
        running = [thread for thread in threading.enumerate() if thread not in threads and not thread.daemon]
        opened = _handles() - handles
        if not running and not opened:
            return
        if time.monotonic() > deadline:
            break
        time.sleep(0.05)
    assert not running, f"threads go on after close(): {running}"
    names = {number: _target(number) for number in opened}
    assert not opened, f"files stay open after close(): {names}"


def _handles() -> set[str]:
    folder = Path("/proc/self/fd")
    return {name for name in os.listdir(folder) if _target(name) is not None} if folder.is_dir() else set()


def _target(number: str) -> str | None:
    """What a file handle is; None for those that come and go by themselves."""
    try:
        target = os.readlink(f"/proc/self/fd/{number}")
    except OSError:
        return None
    return None if target.startswith(("/proc/", "anon_inode:[eventpoll]")) else target


def raised(kinds: tuple[type[BaseException], ...], error: BaseException, doing: str) -> None:
    """Fail unless an error is of the tree."""
    assert isinstance(error, kinds), (
        f"{doing} raised {type(error).__name__}: {error}. It has to be one of "
        f"{', '.join(kind.__name__ for kind in kinds)}: raise the driver's own errors of that kind `from` what the library said."
    )


async def refused(doing: str, kinds: tuple[type[BaseException], ...], call: Awaitable[Any]) -> BaseException:
    """Await what must be refused; the error.

    Raises:
        AssertionError: It was not refused, or with another error.
    """
    try:
        result = await call
    except Exception as error:
        raised(kinds, error, doing)
        return error
    raise AssertionError(f"{doing} was not refused; it returned {result!r}")


async def cancelled_after(rounds: int, call: Coroutine[Any, Any, Any]) -> None:
    """Begin a call, cancel it after so many rounds of the event loop, and wait until it has ended, as well or as badly as it may.

    An error that is not of the tree comes through.
    """
    task = asyncio.ensure_future(call)
    for _ in range(rounds):
        await asyncio.sleep(0)
    task.cancel()
    with suppress(asyncio.CancelledError, DeviceError):
        await task

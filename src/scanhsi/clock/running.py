"""What code asks of the running loop, be its time virtual or real, and how such a loop is started."""

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from contextlib import AbstractContextManager
from typing import Any, TypedDict, TypeVar, TypeVarTuple, Unpack

from scanhsi.clock.real import RealTimeLoop
from scanhsi.clock.virtual import VirtualTimeLoop, check_cost

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


class VirtualOptions(TypedDict, total=False):
    """Arguments of `VirtualTimeLoop`."""

    start: float
    hold_timeout: float
    inline: bool
    external_io: bool
    io_grace: float


def now_ns() -> int:
    """Time of the running loop in ns, from an arbitrary origin."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualTimeLoop | RealTimeLoop):
        return loop.time_ns()
    return round(loop.time() * 1e9)


def is_virtual() -> bool:
    """Whether the running loop's time is virtual."""
    return isinstance(asyncio.get_running_loop(), VirtualTimeLoop)


def loop_name() -> str:
    """The running loop: ``precise`` (`RealTimeLoop`), ``virtual`` (`VirtualTimeLoop`), or the class of another."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualTimeLoop):
        return "virtual"
    kind = type(loop)
    return "precise" if isinstance(loop, RealTimeLoop) else f"{kind.__module__}.{kind.__qualname__}"


def hold() -> AbstractContextManager[None]:
    """Let virtual time stand still while entered; does nothing on a real loop."""
    loop = asyncio.get_running_loop()
    return loop.hold() if isinstance(loop, VirtualTimeLoop) else contextlib.nullcontext()


async def run_blocking(cost_s: float, fn: Callable[[Unpack[Ts]], T], *args: *Ts) -> T:
    """Run blocking `fn(*args)` in a thread and return its result.

    On a virtual loop it takes exactly `cost_s` (the modelled duration, in s), on a real loop what it takes.
    Cancellation does not stop the thread: shield the call if `fn` uses memory that must outlive it.
    """
    check_cost(cost_s)
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualTimeLoop):
        return await loop.run_blocking(cost_s, fn, *args)
    return await loop.run_in_executor(None, fn, *args)


async def sleep_until_ns(when_ns: int) -> None:
    """Sleep until `now_ns` has reached `when_ns`; never returns early, and always yields to the loop once."""
    remaining_ns = when_ns - now_ns()
    while True:
        await asyncio.sleep(max(remaining_ns, 0) * 1e-9)
        remaining_ns = when_ns - now_ns()
        if remaining_ns <= 0:
            return


def run(
    main: Coroutine[Any, Any, T],
    *,
    virtual: bool = False,
    debug: bool | None = None,
    **virtual_options: Unpack[VirtualOptions],
) -> T:
    """Run `main` on a `RealTimeLoop`, or with ``virtual=True`` on a `VirtualTimeLoop`, and clean up as asyncio.run does.

    `virtual_options` are the arguments of `VirtualTimeLoop`; real time has no use for them.
    """

    def make_loop() -> asyncio.AbstractEventLoop:
        return VirtualTimeLoop(**virtual_options) if virtual else RealTimeLoop()

    with asyncio.Runner(debug=debug, loop_factory=make_loop) as runner:
        return runner.run(main)


def run_virtual(
    main: Coroutine[Any, Any, T], *, debug: bool | None = None, **virtual_options: Unpack[VirtualOptions]
) -> T:
    """Run `main` in virtual time: ``run(main, virtual=True, ...)``."""
    return run(main, virtual=True, debug=debug, **virtual_options)

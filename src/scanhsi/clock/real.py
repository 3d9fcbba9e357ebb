"""asyncio's own loop with timers to the microsecond."""

import asyncio
import concurrent.futures
import contextlib
import logging
import select
import selectors
import sys
import threading
import time

Events = list[tuple[selectors.SelectorKey, int]]

JOIN_S = 10.0
"""How long the end of a loop waits for threads."""

_log = logging.getLogger(__name__)


def _precise_selector() -> selectors.BaseSelector:
    """A selector that does not round timeouts up to whole ms, as epoll and poll do.

    ``select`` has microseconds but takes no descriptor above 1023.  So on Linux ``select`` waits for the *epoll*
    descriptor, which stands for all the others: no limit on those, at one more system call a wait.  Only if the epoll
    descriptor itself is out of ``select``'s reach (a process with over 1000 open files) are timers late by up to 1 ms.
    """
    if sys.platform != "linux":
        return selectors.SelectSelector()

    class PreciseEpoll(selectors.EpollSelector):
        def select(self, timeout: float | None = None) -> Events:
            if timeout is not None and timeout > 0 and self.fileno() < 1024:
                ready, _, _ = select.select([self.fileno()], [], [], timeout)
                timeout = 0
                if not ready:
                    return []
            return super().select(timeout)

    return PreciseEpoll()


class RealTimeLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop with timers to the microsecond: its epoll would wait up to 1 ms too long, each time."""

    # What this class needs of asyncio's internals; tests/clock checks the names on every supported Python.
    _default_executor: concurrent.futures.Executor | None
    _executor_shutdown_called: bool

    def __init__(self) -> None:
        super().__init__(_precise_selector())

    def time_ns(self) -> int:
        """The clock of ``time()`` as an integer, in ns."""
        return time.monotonic_ns()

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        """Join the default executor's threads, but not for ever: one that waits for a disk that does not answer is given up."""
        self._executor_shutdown_called = True
        executor = self._default_executor
        if executor is None:
            return
        joined = self.create_future()

        def join() -> None:
            executor.shutdown(wait=True)
            with contextlib.suppress(RuntimeError):  # the loop was closed: nobody waits
                self.call_soon_threadsafe(lambda: joined.done() or joined.set_result(None))

        threading.Thread(target=join, name="scanhsi-join-executor", daemon=True).start()
        try:
            async with asyncio.timeout(JOIN_S if timeout is None else min(timeout, JOIN_S)):
                await joined
        except TimeoutError:
            executor.shutdown(wait=False, cancel_futures=True)
            _log.error("a thread did not end within %g s and is given up: a disk that does not answer?", JOIN_S)

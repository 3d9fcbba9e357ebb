"""asyncio's own loop with timers to the microsecond."""

import asyncio
import select
import selectors
import sys
import time

Events = list[tuple[selectors.SelectorKey, int]]


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

    def __init__(self) -> None:
        super().__init__(_precise_selector())

    def time_ns(self) -> int:
        """The clock of ``time()`` as an integer, in ns."""
        return time.monotonic_ns()

"""What Python and the operating system can do against lateness: asked for by name, told as granted, undone at the end.

None of it is on by default, for each has a price: frozen objects are not collected, a real-time thread goes before all else on its
processor, and threads that change often cost time. What does help, and how much, is in "Measure what a line costs".
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from scanhsi.clock.running import loop_name

WORDS: Final = ("gc", "fifo", "switch")
"""The options by name."""
FIFO_PRIORITY: Final = 10
"""Above all that is not real time, below the kernel's own threads, which serve network and disk (50)."""
SWITCH_INTERVAL_S: Final = 0.0005
"""A tenth of Python's usual interval: so long a thread that computes may keep the loop from running."""


@dataclass(frozen=True, slots=True)
class RealTime:
    """Options against lateness; none by default.

    Attributes:
        gc: Collect garbage once, then freeze what is left: later collections do not walk through it (20 ms and more).
        fifo: SCHED_FIFO priority of the thread that runs the event loop, 1 to 99; 0 leaves it as it is. Threads and processes that
            it starts are not raised: storing must not keep the loop waiting.
        switch_interval_s: After so long Python takes the interpreter from a thread that others wait for; 0 leaves it as it is.
    """

    gc: bool = False
    fifo: int = 0
    switch_interval_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no system can grant."""
        if not 0 <= self.fifo <= 99:
            raise ValueError(f"fifo is a priority of 1 to 99, or 0 for none, not {self.fifo}")
        if self.switch_interval_s < 0:
            raise ValueError(f"switch_interval_s must not be below 0, but is {self.switch_interval_s}")

    @classmethod
    def of(cls, words: str) -> RealTime:
        """From words with commas between: any of ``gc``, ``fifo`` and ``switch``, or ``all``.

        Raises:
            ValueError: Another word.
        """
        named = {word.strip() for word in words.split(",")}
        if unknown := named - {*WORDS, "all"}:
            raise ValueError(f"{', '.join(sorted(unknown))}: there are {', '.join(WORDS)}, or all.")
        chosen = set(WORDS) if "all" in named else named
        return cls("gc" in chosen, FIFO_PRIORITY * ("fifo" in chosen), SWITCH_INTERVAL_S * ("switch" in chosen))

    @property
    def asked(self) -> tuple[str, ...]:
        """Names of the options."""
        return tuple(word for word, on in zip(WORDS, (self.gc, self.fifo, self.switch_interval_s), strict=True) if on)


@dataclass(frozen=True, slots=True)
class Granted:
    """What became of the options.

    Attributes:
        loop: The running event loop: ``precise`` (scanhsi's, timers to the microsecond), ``virtual``, or the class of another.
        asked: Names of the options asked for.
        granted: Name -> what it came to.
        refused: Name -> why not.
    """

    loop: str
    asked: tuple[str, ...]
    granted: dict[str, str] = field(default_factory=dict[str, str])
    refused: dict[str, str] = field(default_factory=dict[str, str])

    def __str__(self) -> str:
        """For people."""
        parts = [f"{name}: {what}" for name, what in self.granted.items()]
        return "; ".join([*parts, *(f"{name} REFUSED: {why}" for name, why in self.refused.items())])


@contextmanager
def real_time(options: RealTime) -> Generator[Granted]:
    """Apply options in the thread of the event loop; undo them on leaving.

    An option that the system refuses is told, in what is yielded, and not an error: the scan is as good as without it.
    """
    told = Granted(loop_name(), options.asked)
    with ExitStack() as undo:
        for name, apply in (
            ("gc", partial(_freeze, undo)),
            ("switch", partial(_switch, undo, options.switch_interval_s)),
            ("fifo", partial(_fifo, undo, options.fifo)),
        ):
            if name in options.asked:
                _try(told, name, apply)
        yield told


def _try(told: Granted, name: str, apply: Callable[[], str]) -> None:
    try:
        told.granted[name] = apply()
    except OSError as error:
        told.refused[name] = str(error.strerror or error)


def _freeze(undo: ExitStack) -> str:
    if not gc.get_freeze_count():  # else somebody else froze some, and nobody could tell ours from theirs
        undo.callback(gc.unfreeze)
    gc.collect()
    gc.freeze()
    return f"{gc.get_freeze_count()} objects frozen"


def _switch(undo: ExitStack, interval_s: float) -> str:
    undo.callback(sys.setswitchinterval, sys.getswitchinterval())
    sys.setswitchinterval(interval_s)
    return f"threads change after {sys.getswitchinterval() * 1e3:g} ms"


def _fifo(undo: ExitStack, priority: int) -> str:
    if sys.platform != "linux":
        raise OSError("this system knows no SCHED_FIFO for a thread")
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError as error:
        raise OSError(
            f"not permitted: run as root, or give the user CAP_SYS_NICE or an rtprio limit of {priority} or more "
            "in /etc/security/limits.conf"
        ) from error
    undo.callback(_back_to, policy, param.sched_priority)
    return f"SCHED_FIFO, priority {priority}"


def _back_to(policy: int, priority: int) -> None:
    """Without CAP_SYS_NICE nobody may clear the reset-on-fork flag again; it does no harm."""
    assert sys.platform == "linux"
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except PermissionError:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))

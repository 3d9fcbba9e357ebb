"""Time: a deterministic virtual-time event loop, and a real-time loop with microsecond timers.

The same engine and the same simulated devices run on either; :func:`run` selects with one flag.  Code reads time
with :func:`now_ns` (or ``loop.time()``), sleeps through asyncio, and puts blocking work behind :func:`run_blocking`.
Rules for code that shall be reproducible in virtual time:

* a bare thread (or ``anyio.to_thread``) that will wake the loop must do so within :func:`hold`, else its callback lands
  at an arbitrary virtual time; ``run_in_executor`` and ``asyncio.to_thread`` need nothing;
* a worker that lives as long as the loop is a ``threading.Thread``, not an executor job: a job stops the clock;
* wait for events, do not poll with short sleeps; let no decision depend on the order of a set of tasks.
"""

from scanhsi.clock.real import RealTimeLoop
from scanhsi.clock.realtime import Granted, RealTime, real_time
from scanhsi.clock.running import (
    VirtualOptions,
    hold,
    is_virtual,
    loop_name,
    now_ns,
    run,
    run_blocking,
    run_virtual,
    sleep_until_ns,
)
from scanhsi.clock.virtual import CLOCK_LIMIT_S, HoldTimeout, VirtualDeadlock, VirtualTimeLoop

__all__ = [
    "CLOCK_LIMIT_S",
    "Granted",
    "HoldTimeout",
    "RealTime",
    "RealTimeLoop",
    "VirtualDeadlock",
    "VirtualOptions",
    "VirtualTimeLoop",
    "hold",
    "is_virtual",
    "loop_name",
    "now_ns",
    "real_time",
    "run",
    "run_blocking",
    "run_virtual",
    "sleep_until_ns",
]

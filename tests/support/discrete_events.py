"""The schedule of a scan as processes that wait for each other, in simpy: written without a look at the recursion.

Times are whole ns, so nothing is rounded. Resources are what they are on a bench: one link, one copier, one writer, pools of
buffers; a sensor that is busy until it may expose again.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import simpy

from scanhsi.timing.bounds import LineDelays

Steps = Generator[Any, Any, None]


class Scan:
    """One scan in the given mode; ``starts`` and ``stored`` are int64 columns in ns after `run`."""

    def __init__(self, delays: LineDelays, mode: str) -> None:
        self.delays, self.mode = delays, mode
        self.lines = len(delays.exposure)
        self.env = simpy.Environment()
        self.link, self.copier, self.writer = (simpy.Resource(self.env, 1) for _ in range(3))
        self.camera_memory = simpy.Container(self.env, init=delays.buffers)
        self.line_memory = simpy.Container(self.env, init=delays.line_buffers or self.lines + 1)
        self.done = [self.env.event() for _ in range(self.lines)]
        self.known = [self.env.event() for _ in range(self.lines)]
        self.sensor_free_ns = 0
        self.starts = np.zeros(self.lines, np.int64)
        self.stored = np.zeros(self.lines, np.int64)

    def run(self) -> Scan:
        self.env.process(self._control())
        self.env.run()
        return self

    def _value(self, name: str, line: int) -> int:
        column = getattr(self.delays, name)
        return 0 if column is None else int(column[line])

    def _control(self) -> Steps:
        for line in range(self.lines):
            if line and self.mode == "sequential":
                yield self.done[line - 1]
            if line and self.mode != "continuous":
                yield self.env.timeout(self._value("actuate", line))
            yield self.camera_memory.get(1)
            yield self.line_memory.get(1)
            trigger = self._value("trigger", line) if line and self.mode != "continuous" else 0
            yield self.env.timeout(max(trigger, self.sensor_free_ns - self.env.now))
            exposed = self.env.process(self._expose(line))
            yield exposed
            if self.mode != "continuous":
                yield self.known[line]

    def _expose(self, line: int) -> Steps:
        self.starts[line] = self.env.now
        exposure = self._value("exposure", line)
        yield self.env.timeout(exposure)
        read = self.env.now + self.delays.readout_ns
        if self.delays.overlap:
            following = self._value(
                "exposure", line
            )  # the next exposure may begin so early that it ends with the read-out
            self.sensor_free_ns = max(self.env.now + self.delays.dead_ns, read - following)
        else:
            self.sensor_free_ns = read
        self.env.process(self._tell(line))
        self.env.process(self._frame(line, read))

    def _tell(self, line: int) -> Steps:
        yield self.env.timeout(self._value("event", line) if self.mode != "continuous" else 0)
        self.known[line].succeed()

    def _frame(self, line: int, read: int) -> Steps:
        with self.link.request() as turn:  # asked for at the end of the exposure, so frames keep their order
            arrival = self.env.now + self.delays.first_row_ns
            yield turn
            yield self.env.timeout(max(arrival - self.env.now, 0))
            yield self.env.timeout(self._value("transfer", line))
            if self.delays.whole_frame:
                yield self.env.timeout(max(read - self.env.now, 0))
        with self.copier.request() as turn:
            yield turn
            yield self.known[line]
            yield self.env.timeout(self._value("copy", line))
            yield self.camera_memory.put(1)
        with self.writer.request() as turn:
            yield turn
            yield self.env.timeout(self._value("store", line))
            yield self.line_memory.put(1)
        self.stored[line] = self.env.now
        self.done[line].succeed()

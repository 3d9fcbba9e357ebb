"""Bytes that are garbled, dropped and doubled on a serial line: a filter, and a port with it between driver and device."""

from __future__ import annotations

import os
import pty
import random
import threading
import tty
from collections.abc import Generator
from contextlib import contextmanager, suppress
from select import select

from scanhsi.testing.faults import FaultPlan, Faults, Kind

_POLL_S = 0.05


class ByteFilter:
    """One direction of a line.

    Args:
        faults: The plan under way.
        rate: Beside the plan: probability of each byte to be damaged, one way or the other.
        seed: Of what is left to chance.
    """

    def __init__(self, faults: Faults, *, rate: float = 0.0, seed: int = 0) -> None:
        self._faults = faults
        self._rate = rate
        self._random = random.Random(seed)
        self.damaged = 0

    def __call__(self, data: bytes) -> bytes:
        """What arrives of some bytes."""
        passed = bytearray()
        for byte in data:
            kind = self._kind()
            self.damaged += kind is not None
            if kind is Kind.BYTE_GARBLED:
                byte ^= 1 << self._random.randrange(8)
            passed += bytes([byte]) * {Kind.BYTE_DROPPED: 0, Kind.BYTE_TWICE: 2}.get(kind or Kind.BYTE_GARBLED, 1)
        return bytes(passed)

    def _kind(self) -> Kind | None:
        kinds = (Kind.BYTE_GARBLED, Kind.BYTE_DROPPED, Kind.BYTE_TWICE)
        planned = [kind for kind in kinds if self._faults.due(kind) is not None]
        if planned:
            return planned[0]
        return self._random.choice(kinds) if self._rate and self._random.random() < self._rate else None


@contextmanager
def faulty_port(port: str, plan: FaultPlan, *, rate: float = 0.0) -> Generator[str]:
    """A serial port that leads to another through a bad cable: give the name that is yielded to the driver.

    Both directions have the plan's faults, each counting its own bytes.

    Args:
        port: Path of the port of the device, or of its twin.
        plan: What goes wrong, of the byte faults.
        rate: Beside the plan: probability of each byte to be damaged.
    """
    device = os.open(port, os.O_RDWR | os.O_NOCTTY)
    ours, theirs = pty.openpty()
    tty.setraw(device)
    tty.setraw(theirs)
    over = threading.Event()
    ways = {
        device: (ours, ByteFilter(Faults(plan), rate=rate, seed=plan.seed)),
        ours: (device, ByteFilter(Faults(plan), rate=rate, seed=plan.seed + 1)),
    }

    def carry() -> None:
        while not over.is_set():
            for source in select(list(ways), [], [], _POLL_S)[0]:
                target, damage = ways[source]
                with suppress(OSError):  # one end is closed: the driver, or the device, finds out by itself
                    os.write(target, damage(os.read(source, 4096)))

    thread = threading.Thread(target=carry, name="scanhsi-bad-cable", daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        over.set()
        thread.join()
        for handle in (device, ours, theirs):
            os.close(handle)

"""A Numato relay module on a pty: its text commands as its user guide has them, and what can go wrong on the line."""

from __future__ import annotations

import os
import pty
import threading
import tty
from collections.abc import Callable
from contextlib import suppress

_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUV"


class RelayModule:
    """Runs in a thread until `close`.

    Attributes:
        relays: Whether each relay is on.
        stuck: Relays that do not follow any more.
        damage: Called with each byte that the module hears; returns what it makes of it.
        deaf: It answers nothing.
        commands: What was understood.
    """

    def __init__(self, count: int = 16) -> None:
        self.relays = [False] * count
        self.stuck: set[int] = set()
        self.damage: Callable[[bytes], bytes] = lambda byte: byte
        self.deaf = False
        self.commands: list[str] = []
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave: int | None = slave  # held, so that the port outlives the driver's closing it
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        if self._slave is not None:
            os.close(self._slave)
            self._slave = None
        os.close(self._master)

    def close(self) -> None:
        if self._slave is not None:
            slave, self._slave = self._slave, None
            os.close(slave)
        self._thread.join(timeout=5)

    def _run(self) -> None:
        with suppress(OSError):  # nobody has the port open any more, or it was unplugged
            line = b""
            while True:
                line = self._hear(line, self.damage(os.read(self._master, 1)))

    def _hear(self, line: bytes, heard: bytes) -> bytes:
        if self.deaf or not heard:
            return line
        if heard != b"\r":
            os.write(self._master, heard)  # the echo
            return line + heard
        answer = self._execute(line.decode("latin-1"))
        os.write(self._master, b"\n\r" + (answer.encode() + b"\n\r" if answer else b"") + b">")
        return b""

    def _execute(self, line: str) -> str:
        match line.split():
            case ["ver"]:
                self.commands.append(line)
                return "00000008"
            case ["relay", word, digit] if digit in _DIGITS and _DIGITS.index(digit) < len(self.relays):
                self.commands.append(line)
                number = _DIGITS.index(digit)
                if word in ("on", "off") and number not in self.stuck:
                    self.relays[number] = word == "on"
                if word == "read":
                    return "on" if self.relays[number] else "off"
        return ""

"""The other end of the line, in memory: a transport that carries bytes to a controller written in Python.

The controller obeys the protocol (stored reply, busy, events) with motions that take a made-up time of the running loop, so that
the driver's whole logic is tested in virtual time. The real firmware is tested in the emulator.
"""

from __future__ import annotations

import asyncio
import binascii
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

Filter = Callable[[bytes], list[bytes]]


def line(mark: str, body: str) -> bytes:
    return f"{mark}{body}*{binascii.crc_hqx(body.encode(), 0):04X}\n".encode()


class MemoryTransport(asyncio.Transport):
    """Carries what the driver writes to `peer.receive`, and what the peer sends to the protocol."""

    def __init__(self, protocol: asyncio.Protocol, peer: Controller) -> None:
        super().__init__()
        self.protocol, self.peer = protocol, peer
        self.closing = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if not self.closing:
            asyncio.get_running_loop().call_later(0.001, self.peer.receive, bytes(data))

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return default

    def is_closing(self) -> bool:
        return self.closing

    def lose(self, error: Exception | None = None) -> None:
        if not self.closing:
            self.closing = True
            asyncio.get_running_loop().call_soon(self.protocol.connection_lost, error)

    def close(self) -> None:
        self.lose()

    def abort(self) -> None:
        self.lose()


@dataclass
class Controller:
    """A controller of the protocol. Every hook is a plain attribute for a test to change."""

    transport: MemoryTransport | None = None
    towards_host: Filter = lambda data: [data]  # noise: what arrives for what is sent
    towards_firmware: Filter = lambda data: [data]
    step_s: float = 0.001
    position: int = 0
    mode: int = 0
    executed: list[str] = field(default_factory=list)
    settings: dict[str, int] = field(default_factory=lambda: {"V": 4000, "A": 20_000, "B": 0})
    identity: str = "scanhsi-stepper 1 328P"
    home_found: bool = True
    never_ends: bool = False
    deaf: bool = False
    last_seq: int = 0
    last_reply: bytes = b""
    done_seq: int = 0
    naks: int = 0
    _target: int = 0
    _motion: asyncio.TimerHandle | None = None
    _motion_seq: int = 0
    _triggers: int = 0
    _buffer: bytearray = field(default_factory=bytearray)

    def send(self, data: bytes) -> None:
        asyncio.get_running_loop().call_later(0.001, self._deliver, self.towards_host(data))

    def _deliver(self, parts: list[bytes]) -> None:
        for part in parts:
            if self.transport and not self.transport.closing:
                self.transport.protocol.data_received(part)

    def receive(self, data: bytes) -> None:
        for part in self.towards_firmware(data):
            self._buffer += part
        while b"\n" in self._buffer:
            text, _, rest = bytes(self._buffer).partition(b"\n")
            self._buffer = bytearray(rest)
            if b">" in text and not self.deaf:
                self._take(text.rpartition(b">")[2])

    def boot(self) -> None:
        """Restart: everything is forgotten."""
        if self._motion:
            self._motion.cancel()
        self.position = self.mode = self.last_seq = self.done_seq = 0
        self.settings = {"V": 4000, "A": 20_000, "B": 0}
        self.send(line("!", "0 BOOT scanhsi-stepper 1 2"))

    def _take(self, text: bytes) -> None:
        body, _, crc = text.rpartition(b"*")
        if crc != b"%04X" % binascii.crc_hqx(body, 0):
            self.naks += 1
            self.send(line("!", f"0 NAK {self.naks}"))
            return
        seq, command, *args = body.decode().split()
        if int(seq) != self.last_seq:
            self.last_seq = int(seq)
            self.executed.append(" ".join([command, *args]))
            answer = self._execute(int(seq), command, [int(arg) for arg in args])
            self.last_reply = line("<", f"{seq} {answer}")
        self.send(self.last_reply)

    def _execute(self, seq: int, command: str, args: list[int]) -> str:
        match command, args:
            case "I", []:
                return f"OK {self.identity}"
            case "Q", []:
                return f"OK {self.mode} {self.position} {self._target} {self.done_seq} 0 1 0 {self.naks}"
            case (("V" | "A" | "B"), [value]):
                self.settings[command] = value
                return f"OK {value}"
            case "E", [_]:
                return "OK"
            case "Z", [value]:
                self.position = value
                return "OK"
            case (("S" | "X"), []):
                if self.mode and not (self.never_ends and command == "S"):
                    self._end(6)
                return "OK"
            case (("MA" | "MR" | "H" | "W"), _) if self.mode:
                return "ERR 3"
            case "MA", [target]:
                return self._begin(seq, 1, target)
            case "MR", [steps]:
                return self._begin(seq, 1, self.position + steps)
            case "H", [_, _]:
                return self._begin(seq, 4, 0)
            case "W", [first, every, count, _]:
                self._triggers = count
                return self._begin(seq, 2, first + every * (count - 1) + 7)
            case _:
                return "ERR 1"

    def _begin(self, seq: int, mode: int, target: int) -> str:
        self.mode, self._target, self._motion_seq = mode, target, seq
        if not self.never_ends:
            code = 5 if mode == 4 and not self.home_found else 0
            duration = self.step_s * abs(target - self.position)
            self._motion = asyncio.get_running_loop().call_later(duration, self._end, code)
        return f"OK {target}"

    def _end(self, code: int) -> None:
        if self._motion:
            self._motion.cancel()
        self.mode = 0
        triggers, self._triggers = self._triggers, 0
        if code:
            self.send(line("!", f"{self._motion_seq} FAIL {code} {self.position} 1000 0"))
        else:
            self.position, self.done_seq = self._target, self._motion_seq
            self.send(line("!", f"{self._motion_seq} DONE {self.position} 1000 {triggers}"))


def connect(controller: Controller, protocol: asyncio.Protocol) -> MemoryTransport:
    controller.transport = MemoryTransport(protocol, controller)
    return controller.transport

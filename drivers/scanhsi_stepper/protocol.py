"""Lines of the stepper protocol: pure functions and values, no input or output.

See docs/reference/stepper-protocol.md. Parsing is total: whatever bytes arrive, `parse` returns a value and never raises.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass, field
from enum import IntEnum

SEQ_MAX = 65_535
_LONGEST_LINE = 128  # the firmware's own limit is 72
_CRC_LENGTH = 5  # "*" and four hex digits


class ErrorCode(IntEnum):
    """Codes of ERR replies and FAIL events."""

    UNKNOWN_COMMAND = 1
    BAD_ARGUMENT = 2
    BUSY = 3
    OUT_OF_RANGE = 4
    NO_HOME_SENSOR = 5
    STOPPED = 6


@dataclass(frozen=True, slots=True)
class Ok:
    """``<seq OK words``: the request was understood, and a motion begun."""

    seq: int
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Err:
    """``<seq ERR code``: the request was refused."""

    seq: int
    code: int


@dataclass(frozen=True, slots=True)
class Ended:
    """``!seq DONE pos us trig`` (code 0) or ``!seq FAIL code pos us trig``: the motion of request `seq` ended.

    Attributes:
        seq: The request.
        code: 0, or why it failed.
        position: Where, in steps.
        us: Firmware time from its start to its last step.
        triggers: Trigger pulses given.
    """

    seq: int
    code: int
    position: int
    us: int
    triggers: int


@dataclass(frozen=True, slots=True)
class Boot:
    """``!0 BOOT name version cause``: the controller has (re)started and knows nothing of what was before."""

    name: str
    version: int
    reset_cause: int


@dataclass(frozen=True, slots=True)
class Nak:
    """``!0 NAK n``: a request arrived damaged; its sender sends it again."""

    count: int


@dataclass(frozen=True, slots=True)
class BadLine:
    """A line with a mark that is not a message: damaged on the way, or another protocol."""

    text: str
    reason: str


@dataclass(frozen=True, slots=True)
class Noise:
    """A line without a mark: a bootloader's chatter, the rest of a line cut at the beginning."""

    text: str


Message = Ok | Err | Ended | Boot | Nak | BadLine | Noise


@dataclass(frozen=True, slots=True)
class Status:
    """Answer to ``Q``; ``mode`` 0 is idle, ``done_seq`` the last request whose motion ended with DONE."""

    mode: int
    position: int
    target: int
    done_seq: int
    home: bool
    enabled: bool
    receive_errors: int
    naks: int

    @classmethod
    def of(cls, words: tuple[str, ...]) -> Status:
        """Read the words of an ``Ok``.

        Raises:
            ValueError: They are not eight integers.
        """
        mode, position, target, done_seq, home, enabled, receive_errors, naks = (int(word) for word in words)
        return cls(mode, position, target, done_seq, bool(home), bool(enabled), receive_errors, naks)


def next_seq(seq: int) -> int:
    """The sequence number after `seq`: 1 to 65535, never 0."""
    return seq % SEQ_MAX + 1


def encode(seq: int, command: str) -> bytes:
    """The request line for a command such as ``"MR 8"``."""
    body = f"{seq} {command}".encode("ascii")
    return b">%b*%04X\n" % (body, binascii.crc_hqx(body, 0))


def parse(line: bytes) -> Message:
    """The meaning of one line, without its line feed. It begins at the *last* mark: what stands before is debris."""
    text = line.decode("ascii", errors="replace")
    start = max(text.rfind("<"), text.rfind("!"))
    if start < 0:
        return Noise(text)
    body, crc = text[start + 1 : -_CRC_LENGTH], text[-_CRC_LENGTH:]
    if len(line) > _LONGEST_LINE:
        return BadLine(text[:_LONGEST_LINE], "too long")
    if crc != f"*{binascii.crc_hqx(body.encode('ascii', errors='replace'), 0):04X}":
        return BadLine(text, "wrong checksum")
    try:
        return (_reply if text[start] == "<" else _event)(body.split(" "))
    except (ValueError, IndexError):
        return BadLine(text, "not a message")


def _reply(words: list[str]) -> Message:
    seq = int(words[0])
    if words[1] == "OK":
        return Ok(seq, tuple(words[2:]))
    if words[1] == "ERR" and len(words) == 3:
        return Err(seq, int(words[2]))
    raise ValueError


def _event(words: list[str]) -> Message:
    seq, kind, rest = int(words[0]), words[1], words[2:]
    if kind == "DONE":
        position, us, triggers = (int(word) for word in rest)
        return Ended(seq, 0, position, us, triggers)
    if kind == "FAIL":
        code, position, us, triggers = (int(word) for word in rest)
        return Ended(seq, code, position, us, triggers)
    if kind == "BOOT":
        name, version, cause = rest
        return Boot(name, int(version), int(cause))
    if kind == "NAK":
        (count,) = rest
        return Nak(int(count))
    raise ValueError


@dataclass(slots=True)
class LineSplitter:
    """Cuts a stream of bytes into lines, in bounded memory."""

    _rest: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that `data` completes, without their line feeds. Of an endless line only the end is kept."""
        *lines, rest = (bytes(self._rest) + data).split(b"\n")
        self._rest = bytearray(rest[-2 * _LONGEST_LINE :])
        return lines

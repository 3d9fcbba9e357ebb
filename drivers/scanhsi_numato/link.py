"""The conversation with the module: a text line ended by CR; it echoes the line, answers, and prompts with ``>``.

Every command may be repeated without harm, so that is what is done about a lost answer.
"""

from __future__ import annotations

import asyncio
import re
from dataclasses import dataclass, field

from scanhsi.devices.errors import DeviceLost, DeviceTimeout
from scanhsi_serial import lost_error

_LONGEST_ANSWER = 1024


@dataclass(slots=True, eq=False)
class NumatoLink(asyncio.Protocol):
    """Protocol of one connection. Make one for each opening of the port.

    Attributes:
        device: Name for messages.
        reply_timeout_s: Time for one answer.
        attempts: How often a command is sent.
        lost: Set once the connection is closed or gone.
    """

    device: str
    reply_timeout_s: float
    attempts: int
    lost: asyncio.Event = field(default_factory=asyncio.Event)
    _transport: asyncio.Transport | None = None
    _lost_cause: BaseException | None = None
    _heard: bytearray = field(default_factory=bytearray)
    _news: asyncio.Event = field(default_factory=asyncio.Event)
    _wire: asyncio.Lock = field(default_factory=asyncio.Lock)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Nothing to do: `attach` has set the transport before the event loop gets here."""

    def attach(self, transport: asyncio.Transport) -> None:
        """Use this transport. Called right after opening."""
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Take bytes as they come."""
        self._heard += data
        del self._heard[:-_LONGEST_ANSWER]
        self._news.set()

    def connection_lost(self, exc: BaseException | None) -> None:
        """Wake whoever waits."""
        self._lost_cause = exc
        self.lost.set()
        self._news.set()

    async def ask(self, command: str) -> str:
        """Send a command; return its answer, which may be empty.

        Raises:
            DeviceTimeout: No answer after the last attempt.
            DeviceLost: The port is gone.
        """
        async with self._wire:
            for _ in range(self.attempts):
                answer = await self._ask_once(command.encode("ascii"))
                if answer is not None:
                    return answer
        raise DeviceTimeout(
            f"no answer to {self.attempts} attempts.",
            device=self.device,
            operation=command,
            waited_s=self.attempts * self.reply_timeout_s,
        )

    async def _ask_once(self, command: bytes) -> str | None:
        if self._transport is None or self._transport.is_closing():  # a write would vanish in silence
            raise self._gone()
        self._heard.clear()
        # The empty line before it ends whatever half a line an earlier, garbled attempt has left in the module.
        self._transport.write(b"\r" + command + b"\r")
        try:
            async with asyncio.timeout(self.reply_timeout_s):
                while (answer := self._answer(command)) is None:
                    self._news.clear()
                    await self._news.wait()
                    if self.lost.is_set():
                        raise self._gone()
        except TimeoutError:
            return None
        return answer

    def _answer(self, command: bytes) -> str | None:
        """What stands between the echo of the command, which has a line to itself, and the prompt."""
        found = re.search(rb"(?:^|[>\r\n])" + re.escape(command) + rb"[\r\n]+([^>]*)>", self._heard)
        return found[1].decode("ascii", "replace").strip() if found else None

    def _gone(self) -> DeviceLost:
        return lost_error(self._lost_cause, self.device)

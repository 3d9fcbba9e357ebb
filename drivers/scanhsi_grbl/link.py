"""The conversation with the controller over one open port: lines and their answers, status reports, resets.

One line is on its way at a time, so that an ``ok`` is that line's; a caller that was cancelled leaves its line here until it is
answered. Nothing here raises inside a callback of the event loop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from scanhsi.clock import now_ns
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceTimeout
from scanhsi_grbl.errors import alarm_error, reply_error, restart_error
from scanhsi_grbl.protocol import Alarm, Banner, Error, Feedback, Message, Noise, Ok, Realtime, Report, Setting, parse
from scanhsi_serial import lost_error

_LONGEST_LINE = 512
_RESTART_S = 3.0  # an alarm's message holds the restart up for half a second


@dataclass(slots=True)
class _Sent:
    line: str
    answered: asyncio.Future[None]
    said: list[Setting | Feedback] = field(default_factory=list[Setting | Feedback])


@dataclass(slots=True, eq=False)
class GrblLink(asyncio.Protocol):
    """Protocol of one connection. Make one for each opening of the port.

    Attributes:
        device: Name for messages.
        reply_timeout_s: Time for one answer.
        on_alarm: Called with an alarm's number; with None when the controller has restarted and nobody asked it to.
        noise: Lines that say nothing: start-up lines, damage.
        lost: Set once the connection is closed or gone.
    """

    device: str
    reply_timeout_s: float = 1.0
    on_alarm: Callable[[int | None], None] = lambda code: None
    noise: int = 0
    lost: asyncio.Event = field(default_factory=asyncio.Event)
    started_ns: int | None = None
    _transport: asyncio.Transport | None = None
    _lost_cause: BaseException | None = None
    _buffer: bytearray = field(default_factory=bytearray)
    _wire: asyncio.Lock = field(default_factory=asyncio.Lock)
    _sent: _Sent | None = None
    _reports: list[asyncio.Future[Report]] = field(default_factory=list[asyncio.Future[Report]])
    _restarts: list[asyncio.Future[None]] = field(default_factory=list[asyncio.Future[None]])
    _offset: tuple[float, ...] | None = None

    # --- called by the event loop ---------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Nothing to do: `attach` has set the transport before the event loop gets here."""

    def attach(self, transport: asyncio.Transport) -> None:
        """Use this transport. Called right after opening."""
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Take bytes as they come."""
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        self._buffer = rest[-_LONGEST_LINE:]
        for line in lines:
            if text := line.decode("ascii", "replace").strip():
                self._take(parse(text))

    def connection_lost(self, exc: BaseException | None) -> None:
        """Fail everybody who waits."""
        self._lost_cause = exc
        self.lost.set()
        self._fail_all(lambda: lost_error(exc, self.device))

    # --- requests -------------------------------------------------------------------------------------------------

    @property
    def unanswered(self) -> bool:
        """Whether a line is on its way whose answer has not come."""
        return self._sent is not None

    async def send(self, line: str, timeout_s: float | None = None) -> list[Setting | Feedback]:
        """Send a line, wait for its ``ok``; return what was said before that.

        Raises:
            DeviceTimeout: No answer. The line may have been carried out, and its answer may still come.
            PositionLost: The controller restarted meanwhile.
            DeviceLost: The port is gone.
            DeviceError: The controller refuses (`reply_error`) or raises an alarm (`alarm_error`).
        """
        limit_s = timeout_s or self.reply_timeout_s
        async with self._wire:
            if (earlier := self._sent) is not None:  # of a caller that was cancelled, or of a lost answer
                await asyncio.wait([earlier.answered], timeout=self.reply_timeout_s)
                if not earlier.answered.done():
                    raise self._silent("an earlier line", self.reply_timeout_s)
            sent = self._sent = _Sent(line, asyncio.get_running_loop().create_future())
            try:
                self._write(line.encode("ascii") + b"\n")
            except DeviceLost:
                self._sent = None
                raise
            try:
                async with asyncio.timeout(limit_s):
                    await asyncio.shield(sent.answered)
            except TimeoutError:
                raise self._silent(line, limit_s) from None
            finally:
                sent.answered.add_done_callback(_seen)
            return sent.said

    async def status(self) -> Report:
        """Ask for a status report; its ``machine`` position is filled in.

        Raises:
            DeviceTimeout: None came: the controller homes, or is deaf.
            DeviceLost, PositionLost, DeviceError: As `send`.
        """
        deadline = now_ns() + round(self.reply_timeout_s * 1e9)
        while (left_ns := deadline - now_ns()) > 0:
            report = asyncio.get_running_loop().create_future()
            self._reports.append(report)
            self._write(bytes([Realtime.STATUS]))
            try:
                async with asyncio.timeout(left_ns / 1e9):
                    answer = await report
            except TimeoutError:
                break
            finally:
                if report in self._reports:
                    self._reports.remove(report)
            if answer.machine is not None:
                return answer
        raise self._silent("?", self.reply_timeout_s)

    def realtime(self, character: Realtime) -> None:
        """Send a character that acts at once.

        Raises:
            DeviceLost: The port is gone.
        """
        self._write(bytes([character]))

    async def reset(self) -> None:
        """Restart the controller's program: it stops at once, and keeps its position where it stood.

        Raises:
            DeviceTimeout: It does not come up again.
            DeviceLost: The port is gone.
        """
        restarted = self.restart()
        self._write(bytes([Realtime.RESET]))
        await self.await_restart(restarted)

    def restart(self) -> asyncio.Future[None]:
        """Expect a restart that is asked for."""
        restarted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        restarted.add_done_callback(_seen)
        self._restarts.append(restarted)
        return restarted

    async def await_restart(self, restarted: asyncio.Future[None]) -> None:
        """Wait for a restart; raises as `reset`."""
        try:
            async with asyncio.timeout(_RESTART_S):
                await restarted
        except TimeoutError:
            raise self._silent("reset", _RESTART_S) from None
        finally:
            self.forget(restarted)

    def forget(self, restarted: asyncio.Future[None]) -> None:
        """Expect that restart no longer."""
        if restarted in self._restarts:
            self._restarts.remove(restarted)

    def _write(self, data: bytes) -> None:
        if self._transport is None or self._transport.is_closing():  # a write would vanish in silence
            raise lost_error(self._lost_cause, self.device)
        self._transport.write(data)

    def _silent(self, operation: str, waited_s: float) -> DeviceTimeout:
        return DeviceTimeout("no answer.", device=self.device, operation=operation, waited_s=waited_s)

    # --- lines ----------------------------------------------------------------------------------------------------

    def _take(self, message: Message) -> None:
        match message:
            case Ok():
                self._answer(None)
            case Error(code):
                self._answer(reply_error(code, self.device, self._sent.line if self._sent else "?"))
            case Alarm(code):
                self.on_alarm(code)
                operation = self._sent.line if self._sent else None
                self._fail_all(lambda: alarm_error(code, self.device, operation))
            case Banner():
                self._restarted()
            case Report():
                self._report(message)
            case Setting() | Feedback():
                if self._sent:
                    self._sent.said.append(message)
            case Noise():
                self.noise += 1

    def _answer(self, error: DeviceError | None) -> None:
        sent, self._sent = self._sent, None
        if sent is None or sent.answered.done():
            return
        if error is None:
            sent.answered.set_result(None)
        else:
            sent.answered.set_exception(error)

    def _report(self, report: Report) -> None:
        self._offset = report.offset or self._offset
        machine = report.machine
        if machine is None and report.work is not None and self._offset is not None:
            machine = tuple(work + offset for work, offset in zip(report.work, self._offset, strict=False))
        waiting, self._reports = self._reports, []
        for future in waiting:
            if not future.done():
                future.set_result(Report(report.state, report.stage, machine, report.work, report.offset))

    def _restarted(self) -> None:
        self.started_ns, self._offset = now_ns(), None
        asked_for, self._restarts = self._restarts, []
        if not asked_for:
            self.on_alarm(None)
        self._fail_all(lambda: restart_error(self.device))
        for restarted in asked_for:
            if not restarted.done():
                restarted.set_result(None)

    def _fail_all(self, error: Callable[[], DeviceError]) -> None:
        waiting: list[asyncio.Future[None] | asyncio.Future[Report]] = [*self._reports]
        if self._sent is not None:
            waiting.append(self._sent.answered)
        if self.lost.is_set():
            waiting += self._restarts
        self._sent, self._reports = None, []
        for future in waiting:
            if not future.done():
                future.set_exception(error())  # one object for each: a traceback must not grow from two sides


def _seen(future: asyncio.Future[None]) -> None:
    """No complaint about an exception that nobody waits for any more."""
    with suppress(asyncio.CancelledError):
        future.exception()

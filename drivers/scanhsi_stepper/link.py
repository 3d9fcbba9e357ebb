"""The conversation with the controller over one open port: requests, retries and events.

Rules (docs/reference/stepper-protocol.md): one request on the wire at a time; a retry keeps its sequence number, so that the
controller executes nothing twice; after a BOOT nothing that was asked before is ever sent again. What was damaged, either way, is
asked for again at once. Nothing here raises inside a callback of the event loop: what cannot be understood is counted.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from scanhsi.clock import now_ns
from scanhsi.devices.errors import DeviceError, DeviceTimeout
from scanhsi_serial import lost_error
from scanhsi_stepper.errors import boot_error, device_name, reply_error
from scanhsi_stepper.protocol import (
    BadLine,
    Boot,
    Ended,
    Err,
    LineSplitter,
    Message,
    Nak,
    Noise,
    Ok,
    encode,
    next_seq,
    parse,
)

_REPLY_NS = 2_000_000  # no request is answered sooner: with less time left there is no use in asking again


@dataclass(slots=True)
class Counters:
    """What happened on the line since it was opened.

    Attributes:
        bad_lines: Lines that were damaged.
        noise: Lines without a mark.
        stale: Replies and events that nobody waited for (duplicates after a retry, motions given up).
        naks: Requests that reached the controller damaged.
        resends: Requests sent again.
        boots: Restarts of the controller.
        done_by_poll: Motions whose end was learnt by asking, because the DONE event was lost.
    """

    bad_lines: int = 0
    noise: int = 0
    stale: int = 0
    naks: int = 0
    resends: int = 0
    boots: int = 0
    done_by_poll: int = 0


@dataclass(frozen=True, slots=True)
class Arrived:
    """The end of a motion and the loop time in ns at which its line arrived."""

    message: Ended
    at_ns: int


@dataclass(slots=True)
class Running:
    """A motion under way.

    Attributes:
        seq: Of its request.
        commanded_ns: When it was asked for; loop clock.
        end: Its end.
        confirmed_ns: When the request was confirmed; loop clock.
        news: Set when it has ended, or a damaged line may have said so.
    """

    seq: int
    commanded_ns: int
    end: asyncio.Future[Arrived]
    confirmed_ns: int = 0
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def __post_init__(self) -> None:
        self.end.add_done_callback(lambda _: self.news.set())


@dataclass(slots=True)
class _Pending:
    seq: int
    answer: asyncio.Future[Ok | Err | Nak | BadLine]


def _random_seq() -> int:
    """Where an earlier connection hardly left off, so that its stored reply does not match our first request."""
    return random.randint(1, 60_000)


@dataclass(slots=True, eq=False)
class StepperLink(asyncio.Protocol):
    """Protocol of one connection. Make one for each opening of the port.

    Attributes:
        port: Name for messages.
        reply_timeout_s: Time for one reply.
        attempts: How often a request is sent; more often within the time for all these replies, where only damaged ones come.
        on_boot: Called when the controller has restarted.
        counters: What happened on the line.
        lost: Set once the connection is closed or gone.
    """

    port: str
    reply_timeout_s: float = 0.25
    attempts: int = 4
    on_boot: Callable[[], None] = lambda: None
    counters: Counters = field(default_factory=Counters)
    lost: asyncio.Event = field(default_factory=asyncio.Event)
    _transport: asyncio.Transport | None = None
    _lost_cause: BaseException | None = None
    _splitter: LineSplitter = field(default_factory=LineSplitter)
    _seq: int = field(default_factory=_random_seq)
    _wire: asyncio.Lock = field(default_factory=asyncio.Lock)
    _pending: _Pending | None = None
    _running: dict[int, Running] = field(default_factory=dict[int, Running])

    # --- called by the event loop ---------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Nothing to do: `attach` has set the transport before the event loop gets here."""

    def attach(self, transport: asyncio.Transport) -> None:
        """Use this transport. Called right after opening, because ``connection_made`` comes later than the first request."""
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Take bytes as they come."""
        for line in self._splitter.feed(data):
            self._take(parse(line))

    def connection_lost(self, exc: BaseException | None) -> None:
        """Fail everybody who waits."""
        self._lost_cause = exc
        self.lost.set()
        self._fail_all(lambda: lost_error(exc, device_name(self.port)))

    # --- requests -------------------------------------------------------------------------------------------------

    async def request(self, command: str, *, attempts: int | None = None) -> tuple[str, ...]:
        """Send a command and return the words of its OK.

        Raises:
            DeviceTimeout: No answer after the last attempt.
            PositionLost: The controller restarted meanwhile; the command may or may not have been executed.
            DeviceLost: The port is gone.
            DeviceBusy, OutOfRange, ProtocolError: The controller refuses; see `reply_error`.
        """
        async with self._wire:
            return await self._exchange(self._take_seq(), command, attempts or self.attempts)

    async def start(self, command: str) -> Running:
        """Send a command that begins a motion; its end is in the result's ``end``. Raises as `request`."""
        async with self._wire:
            running = Running(self._take_seq(), now_ns(), asyncio.get_running_loop().create_future())
            # Before sending: the DONE of a short motion follows the OK in the same breath.
            self._running[running.seq] = running
            try:
                await self._exchange(running.seq, command, self.attempts)
            except BaseException:
                self.forget(running)
                raise
            running.confirmed_ns = now_ns()
            return running

    def forget(self, running: Running) -> None:
        """Wait no longer for the end of a motion."""
        self._running.pop(running.seq, None)
        if not running.end.done():
            running.end.cancel()
        elif not running.end.cancelled():
            running.end.exception()  # seen: no complaint about an exception that was never retrieved

    @property
    def next_seq(self) -> int:
        """Sequence number of the next request."""
        return next_seq(self._seq)

    def _take_seq(self) -> int:
        self._seq = self.next_seq
        return self._seq

    async def _exchange(self, seq: int, command: str, attempts: int) -> tuple[str, ...]:
        line, limit_ns = encode(seq, command), round(self.reply_timeout_s * 1e9)
        began, sent, boots = now_ns(), 0, self.counters.boots
        until = began + attempts * limit_ns
        while sent < attempts or until - now_ns() > _REPLY_NS:
            self.counters.resends += sent > 0
            wait_ns = limit_ns if sent < attempts else min(limit_ns, until - now_ns())
            answer = await self._send_once(seq, line, wait_ns * 1e-9)
            sent += 1
            if isinstance(answer, Err):
                raise reply_error(answer.code, self.port, command)
            if isinstance(answer, Ok):
                return answer.words
            if self.counters.boots != boots:  # its BOOT came in one breath with a damaged line
                raise boot_error(self.port)
        raise DeviceTimeout(
            f"no answer to {sent} attempts ({self.counters.bad_lines} damaged lines so far).",
            device=device_name(self.port),
            operation=command,
            waited_s=(now_ns() - began) * 1e-9,
        )

    async def _send_once(self, seq: int, line: bytes, limit_s: float) -> Ok | Err | Nak | BadLine | None:
        """One attempt: the answer, word that something was damaged, or None after ``limit_s``."""
        transport = self._transport
        if transport is None or transport.is_closing():  # a write would vanish in silence
            raise lost_error(self._lost_cause, device_name(self.port))
        pending = _Pending(seq, asyncio.get_running_loop().create_future())
        self._pending = pending
        transport.write(line)
        try:
            async with asyncio.timeout(limit_s):
                return await pending.answer
        except TimeoutError:
            return None
        finally:
            self._pending = None
            if pending.answer.done() and not pending.answer.cancelled():
                pending.answer.exception()

    # --- lines ----------------------------------------------------------------------------------------------------

    def _take(self, message: Message) -> None:
        match message:
            case Ok() | Err():
                self._answer(message, message.seq)
            case Ended():
                self._end(message)
            case Nak():
                self.counters.naks += 1
                if self._pending:
                    self._answer(message, self._pending.seq)
            case Boot():
                self.counters.boots += 1
                self._fail_all(lambda: boot_error(self.port))
                self.on_boot()
            case BadLine():
                self.counters.bad_lines += 1
                self._doubt(message)
            case Noise():
                self.counters.noise += 1

    def _doubt(self, damaged: BadLine) -> None:
        """It was the answer, or else the end of a motion: let those who wait ask. If it was not, they hear it twice."""
        if self._pending and not self._pending.answer.done():
            self._pending.answer.set_result(damaged)
        elif not self._pending:
            for running in self._running.values():
                running.news.set()

    def _answer(self, message: Ok | Err | Nak, seq: int) -> None:
        pending = self._pending
        if pending is None or pending.seq != seq or pending.answer.done():
            self.counters.stale += 1
        else:
            pending.answer.set_result(message)

    def _end(self, message: Ended) -> None:
        running = self._running.pop(message.seq, None)
        if running is None or running.end.done():
            self.counters.stale += 1
        else:
            running.end.set_result(Arrived(message, now_ns()))

    def _fail_all(self, error: Callable[[], DeviceError]) -> None:
        waiting = [running.end for running in self._running.values()]
        self._running.clear()
        if self._pending:
            waiting.append(self._pending.answer)  # pyright: ignore[reportArgumentType] (only failed here, never given a result)
        for future in waiting:
            if not future.done():
                future.set_exception(error())  # one object for each: a traceback must not grow from two sides

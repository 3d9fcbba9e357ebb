"""The light: one relay of a Numato USB relay module. Each switching is read back."""

from __future__ import annotations

import asyncio
import contextlib

from scanhsi.clock import now_ns
from scanhsi.devices.errors import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, DeviceTimeout, ProtocolError
from scanhsi.devices.light import LightInfo, Lit
from scanhsi.devices.values import Range
from scanhsi_numato.link import NumatoLink
from scanhsi_numato.options import NumatoOptions
from scanhsi_serial import close_port, open_port

_CLOSE_S = 1.0
_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUV"  # relays from 10 on have letters


class NumatoLight:
    """See `scanhsi.devices.light.Light` for the contract."""

    def __init__(self, options: NumatoOptions) -> None:
        self._options = options
        self._name = f"light numato {options.port}"
        self._relay = _DIGITS[options.relay]
        self._link: NumatoLink | None = None
        self._transport: asyncio.Transport | None = None
        self._info: LightInfo | None = None
        self._lit: bool | None = None  # None = not known
        self._lit_ns = 0
        self._offs = 0
        self._switching = asyncio.Lock()

    @property
    def info(self) -> LightInfo:
        """What the light is and allows."""
        if self._info is None:
            raise self._error("not connected.", "info")
        return self._info

    @property
    def level(self) -> float:
        """1 or 0."""
        if self._lit is None:
            raise self._error("it is not known whether it is on.", "level")
        return float(self._lit)

    async def connect(self) -> None:
        """Open the port and read the state of the relay."""
        if self._link is not None and not self._link.lost.is_set():
            raise DeviceBusy("already connected.", device=self._name, operation="connect")
        await self._close_port()
        options = self._options
        self._transport, link = await open_port(options.port, options.baud, self._new_link, self._name)
        link.attach(self._transport)
        self._link = link
        try:
            version = await link.ask("ver")
            self._lit = await self._read(link)
        except DeviceTimeout as error:
            await self._close_port()
            raise DeviceNotFound(
                "nothing that speaks like a Numato relay module answers.",
                device=self._name,
                operation="connect",
                waited_s=error.waited_s,
                hint="is it this port? `ls /dev/serial/by-id` lists ports.",
            ) from error
        except BaseException:
            await self._close_port()
            raise
        self._lit_ns = now_ns()
        self._info = LightInfo(
            name=self._name,
            model=f"Numato relay module, relay {options.relay}",
            firmware=version,
            levels=Range(1.0, 1.0),
            warm_up_s=options.warm_up_s,
            simulated=options.simulated,
        )

    async def close(self) -> None:
        """Switch off, then close the port. Cancelled before it is off, it leaves the port open for another ``off`` or ``close``."""
        try:
            if self._link is not None and not self._link.lost.is_set():
                with contextlib.suppress(DeviceLost):
                    await self.off()
        except Exception:
            await self._close_port()
            raise
        await self._close_port()

    async def on(self, level: float | None = None) -> Lit:
        """Switch on; a light that is on already stays on."""
        link = self._connected("on")
        self.info.levels.check("level", 1.0 if level is None else level, device=self._name)
        commanded, offs = now_ns(), self._offs
        async with self._switching:
            if offs == self._offs:
                was_lit = self._lit
                await self._switch(link, True)
                self._lit_ns = self._lit_ns if was_lit else now_ns()
            if offs != self._offs:  # `off` waits behind this, or has been here
                raise self._error("it was switched off meanwhile.", "on")
        return Lit(1.0, commanded, self._lit_ns, self._lit_ns + round(self.info.warm_up_s * 1e9))

    async def off(self) -> None:
        """Switch off."""
        link = self._connected("off")
        self._offs += 1
        async with self._switching:
            await self._switch(link, False)

    async def _switch(self, link: NumatoLink, lit: bool) -> None:
        self._lit = None
        word = "on" if lit != self._options.normally_closed else "off"
        await link.ask(f"relay {word} {self._relay}")
        self._lit = await self._read(link)
        if self._lit is not lit:
            raise self._error(f"the relay stays {'off' if word == 'on' else 'on'}.", "on" if lit else "off")

    async def _read(self, link: NumatoLink) -> bool:
        command = f"relay read {self._relay}"
        answer = await link.ask(command)
        if answer not in ("on", "off"):
            raise ProtocolError(
                f"the state of the relay reads {answer!r}.",
                device=self._name,
                operation=command,
                hint="has the module that many relays?",
            )
        return (answer == "on") != self._options.normally_closed

    def _new_link(self) -> NumatoLink:
        return NumatoLink(self._name, self._options.reply_timeout_s, self._options.reply_attempts)

    async def _close_port(self) -> None:
        link, transport = self._link, self._transport
        self._link = self._transport = self._lit = None
        if link is not None and transport is not None:
            await close_port(transport, link.lost, _CLOSE_S)

    def _connected(self, operation: str) -> NumatoLink:
        if self._link is None:
            raise self._error("not connected.", operation)
        return self._link

    def _error(self, message: str, operation: str) -> DeviceError:
        return DeviceError(message, device=self._name, operation=operation)

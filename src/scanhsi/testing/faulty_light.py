"""A light that fails as a plan says, around any light."""

from __future__ import annotations

from scanhsi.devices import Light, LightInfo, Lit
from scanhsi.devices.errors import DeviceTimeout
from scanhsi.testing.faults import Faults, Kind
from scanhsi.testing.faulty_camera import wait_s


class FaultyLight:
    """Obeys the light contract but for what its plan says.

    Args:
        inner: The light.
        faults: The plan under way.
    """

    def __init__(self, inner: Light, faults: Faults) -> None:
        self.inner = inner
        self._faults = faults

    @property
    def info(self) -> LightInfo:
        """As of the light inside."""
        return self.inner.info

    @property
    def level(self) -> float:
        """What is true."""
        return self.inner.level

    async def connect(self) -> None:
        """Open it."""
        await self.inner.connect()

    async def close(self) -> None:
        """Close it, which switches it off."""
        await self.inner.close()

    async def on(self, level: float | None = None) -> Lit:
        """Switch it on, if it answers."""
        await self._answers("on")
        return await self.inner.on(level)

    async def off(self) -> None:
        """Switch it off, if it answers."""
        await self._answers("off")
        await self.inner.off()

    async def _answers(self, operation: str) -> None:
        if (fault := self._faults.due(Kind.LIGHT_UNANSWERED)) is not None:
            await wait_s(fault.for_s)
            raise DeviceTimeout("no answer.", device=self.info.name, operation=operation)

"""The simulated light: while one stands on the bench, the camera sees nothing unless it is on."""

from __future__ import annotations

import asyncio
import math

from pydantic import BaseModel, ConfigDict, Field

from scanhsi.clock import now_ns
from scanhsi.devices.errors import DeviceError
from scanhsi.devices.light import LightInfo, Lit
from scanhsi.devices.values import Range
from scanhsi_sim.bench import bench


class LightOptions(BaseModel):
    """Options of the simulated light."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bench: str = Field(default="bench", description="the camera with the same word sees it")
    warm_up_s: float = Field(default=0.0, ge=0, description="how long a scan waits after switching it on")
    switch_s: float = Field(default=0.01, ge=0, description="how long switching takes")


class SimulatedLight:
    """See `scanhsi.devices.light.Light` for the contract. It cannot be dimmed; its brightness is that of the camera's ``lamp``."""

    def __init__(self, options: LightOptions) -> None:
        self._options = options
        self._bench = bench(options.bench)
        self._name = f"light simulated {options.bench}"
        self._info: LightInfo | None = None
        self._switched = asyncio.Lock()
        self._offs = 0

    @property
    def info(self) -> LightInfo:
        """What the light is and allows."""
        if self._info is None:
            raise self._error("info")
        return self._info

    @property
    def level(self) -> float:
        """1 or 0."""
        self._connected("level")
        return 0.0 if self._bench.lit_since(now_ns()) == math.inf else 1.0

    async def connect(self) -> None:
        """Take the light's place on the bench."""
        self._bench.claim("light", self, self._name)
        self._bench.lit = self._bench.lit or [(0, False)]
        self._info = LightInfo(
            name=self._name,
            model="simulated light",
            firmware="none",
            levels=Range(1.0, 1.0),
            warm_up_s=self._options.warm_up_s,
            simulated=True,
        )

    async def close(self) -> None:
        """Switch off and leave the bench, whose camera from then on sees as if nothing could be switched."""
        if self._info is not None:
            await self.off()
            self._info, self._bench.lit = None, []
            self._bench.release("light", self)

    async def on(self, level: float | None = None) -> Lit:
        """Switch on."""
        info = self._connected("on")
        info.levels.check("level", 1.0 if level is None else level, device=self._name)
        commanded, offs = now_ns(), self._offs
        async with self._switched:
            await asyncio.sleep(self._options.switch_s)
            if offs != self._offs:
                raise DeviceError("it was switched off meanwhile.", device=self._name, operation="on")
            if self._bench.lit_since(now_ns()) == math.inf:
                self._bench.lit.append((now_ns(), True))
        lit_ns = round(self._bench.lit_since(now_ns()))
        return Lit(1.0, commanded, lit_ns, lit_ns + round(info.warm_up_s * 1e9))

    async def off(self) -> None:
        """Switch off."""
        self._connected("off")
        self._offs += 1
        async with self._switched:
            await asyncio.sleep(self._options.switch_s)
            if self._bench.lit_since(now_ns()) != math.inf:
                self._bench.lit.append((now_ns(), False))

    def _connected(self, operation: str) -> LightInfo:
        if self._info is None:
            raise self._error(operation)
        return self._info

    def _error(self, operation: str) -> DeviceError:
        return DeviceError("it is not connected.", device=self._name, operation=operation)

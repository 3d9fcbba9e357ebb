"""What the tests of the GenICam driver share."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from scanhsi.clock import run
from scanhsi.devices import CameraSettings, PixelFormat, Roi, Trigger
from scanhsi_genicam import GenicamCamera, GenicamOptions

Scenario = Callable[[GenicamCamera], Awaitable[None]]
SETTINGS = CameraSettings(0.005, 0.0, PixelFormat.MONO8, Roi(16, 8, 64, 32))


def with_camera(scenario: Scenario, **options: Any) -> None:
    async def main() -> None:
        chosen = {"address": "127.0.0.1", "discovery_s": 0.05, "frame_timeout_s": 0.3, **options}
        camera = GenicamCamera(GenicamOptions(interface="lo", **chosen))
        try:
            await camera.connect()
            await camera.configure(SETTINGS)
            await camera.arm(Trigger.SOFTWARE, 4)
            await scenario(camera)
        finally:
            await camera.close()

    run(main())


async def scan(camera: GenicamCamera) -> None:
    """Take many frames."""
    async with asyncio.timeout(30):
        for _ in range(100):
            await camera.expose()
            await anext(camera.frames())

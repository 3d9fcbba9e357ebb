"""Scans of both twins as one instrument."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import scanhsi
from scanhsi import clock
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim.twins.rig import TwinRig


def instrument(rig: TwinRig) -> InstrumentConfig:
    return load_instrument("twin", {"actuator.port": rig.port, "camera.address": rig.camera_address})


def scan_twin(plan: dict[str, object], output: Path, beside: Callable[[TwinRig], Awaitable[None]] | None = None):
    """Scan the test pattern; return the report and the steps that the firmware truly gave, by the emulator's pin trace."""

    async def main() -> tuple[scanhsi.ScanReport, dict[str, int], int]:
        async with TwinRig(scene="testpattern") as rig:
            async with scanhsi.open_instrument(instrument(rig)) as hsi:
                if beside is not None:
                    asyncio.get_running_loop().create_task(beside(rig))
                report = await hsi.scan(hsi.default_plan(**plan), output)
                position = hsi.actuator.position
            return report, await rig.stepper.stats(), position

    return clock.run(main())

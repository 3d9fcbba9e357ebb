"""The light of a scan: on and steady before the first line, off on every way out."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from typing import Final

from scanhsi.clock import now_ns
from scanhsi.engine.cleanup import CleanupStep
from scanhsi.engine.deadlines import STOP_S, Part
from scanhsi.engine.scan import Scan

LIGHT_S: Final = 15.0
"""Switching the light on; warming up has its own time."""


async def light_up(scan: Scan) -> None:
    """Switch the light on and wait until it is steady. A request to stop ends the waiting: no line is under way."""
    if scan.light is None or scan.over:
        return
    async with scan.watch(Part.LIGHT, LIGHT_S, "on"):
        lit = await scan.light.on()
    if lit.steady_ns > now_ns():
        scan.tell_state("warming up")
        with suppress(TimeoutError):
            async with asyncio.timeout((lit.steady_ns - now_ns()) * 1e-9):
                await scan.control.stop.wait()
        scan.tell_state("scanning")


def lights_off(scan: Scan) -> list[CleanupStep]:
    """Switch it off, beside whatever else is done on the way out; nothing where there is no light."""
    if scan.light is None:
        return []
    return [
        CleanupStep(
            "switch the light off",
            scan.light.off,
            STOP_S,
            device=scan.watch.names[Part.LIGHT],
            unsafe="the light may be on",
            failed=partial(scan.watch.blame, Part.LIGHT),
        )
    ]

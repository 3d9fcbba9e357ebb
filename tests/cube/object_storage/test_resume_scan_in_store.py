"""A whole scan into a bucket, interrupted and finished by another session, also through a spool."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import NotACube
from scanhsi.engine import ScanControl
from support.scans import small


async def begin(url: str, spool: Path | None) -> int:
    control = ScanControl()
    async with scanhsi.open_instrument(small()) as hsi:
        asyncio.get_running_loop().call_later(0.4, control.stop.set)
        plan = hsi.default_plan(lines=30, exposure="10 ms", pixel_format="Mono8")
        return (await hsi.scan(plan, url, control=control, spool=spool)).stored


async def finish(url: str, spool: Path | None) -> scanhsi.ScanReport:
    async with scanhsi.open_instrument(small()) as hsi:
        return await hsi.resume(url, spool=spool)


@pytest.mark.parametrize("spooled", [False, True])
def test_an_interrupted_scan_in_a_bucket_is_finished(url: str, tmp_path: Path, spooled: bool) -> None:
    spool = tmp_path / "spool" if spooled else None
    with pytest.raises(NotACube):
        run_virtual(finish(url, spool))
    stored = run_virtual(begin(url, spool))
    assert 0 < stored < 30
    if spool is not None:
        scanhsi.drain(spool)  # the other session is this process: it still sends
    report = run_virtual(finish(url, spool))
    assert (report.stored, report.resumed_at) == (30, stored)
    if spool is not None:
        scanhsi.drain(spool)
    assert scanhsi.open_cube(url)["run"].values.tolist() == [0] * stored + [1] * (30 - stored)

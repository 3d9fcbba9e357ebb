"""Lines are shown on their way to storage, and without any; a live view shows frames until it is cancelled."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi.clock import now_ns, run_virtual
from scanhsi.cube.records import LineRecords
from scanhsi.devices.errors import DeviceBusy
from scanhsi.devices.frames import Pixels
from scanhsi.instrument import load_instrument
from scanhsi_sim.scenes.testpattern import decode
from support.small import SMALL


@pytest.mark.parametrize("stored", [True, False])
def test_every_line_is_shown_as_it_is_stored(stored: bool, tmp_path: Path) -> None:
    seen: dict[int, np.ndarray] = {}

    def watch(line: int, pixels: Pixels, records: LineRecords) -> None:
        assert records.stamps["copied"][line] > 0
        seen[line] = pixels.copy()

    async def main() -> None:
        async with scanhsi.open_instrument(load_instrument("sensors2019", SMALL)) as hsi:
            await hsi.scan(hsi.default_plan(lines=30), tmp_path / "a.zarr" if stored else None, watch=watch)

    run_virtual(main())
    assert list(seen) == list(range(30))
    if stored:
        cube = scanhsi.open_cube(tmp_path / "a.zarr")["cube"].values
        assert all((cube[:, line] == pixels).all() for line, pixels in seen.items())
    else:
        steps = [decode(pixels, offset=(500, 1000)).step for pixels in seen.values()]
        assert set(np.diff(steps)) <= {2, 2 - 4096}


def test_a_live_view_keeps_its_pace_where_the_mirror_stands() -> None:
    seen: list[tuple[int, int]] = []

    def watch(line: int, pixels: Pixels, records: LineRecords) -> None:
        del line, records
        seen.append((decode(pixels, offset=(500, 1000)).step, now_ns()))

    async def main() -> None:
        async with scanhsi.open_instrument(load_instrument("sensors2019", SMALL)) as hsi:
            await hsi.actuator.home()
            await hsi.actuator.move_to(40)
            view = asyncio.ensure_future(hsi.live(watch, period_s=0.2, exposure_s=0.01))
            await asyncio.sleep(3)
            with pytest.raises(DeviceBusy):
                await hsi.scan(hsi.default_plan(lines=2), None)
            view.cancel()
            await asyncio.gather(view, return_exceptions=True)
            assert (await hsi.scan(hsi.default_plan(lines=2), None)).missing == 0

    run_virtual(main())
    steps, times = zip(*seen, strict=True)
    assert set(steps) == {40}
    assert np.diff(times).min() >= 0.19e9
    assert 12 <= len(seen) <= 15

"""An instrument with a light: on for scans and white references, off between them, and left off for dark ones."""

from __future__ import annotations

from pathlib import Path

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.instrument import load_instrument

LIT = {
    "roi.samples": 24,
    "roi.bands": 16,
    "roi.sample_offset": 1000,
    "roi.band_offset": 500,
    "camera.scene": "white",
    "light.driver": "simulated",
    "light.warm_up_s": 20.0,
}


def test_scans_see_light_and_dark_references_do_not(tmp_path: Path) -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(load_instrument("sensors2019", LIT)) as hsi:
            light, plan = hsi.instrument.light, hsi.default_plan(lines=4)
            assert light is not None
            for target in ("white", "dark"):
                await hsi.scan(plan, tmp_path / f"{target}.zarr", target=target)
                assert light.level == 0

    run_virtual(main())
    white, dark = (scanhsi.open_cube(tmp_path / f"{target}.zarr") for target in ("white", "dark"))
    assert float(dark["cube"].mean()) < 0.2 * float(white["cube"].mean())
    described = white.attrs["instrument"]
    assert "light" in str(described)


def test_a_light_that_was_left_on_does_not_shine_on_a_dark_reference(tmp_path: Path) -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(load_instrument("sensors2019", LIT)) as hsi:
            light = hsi.instrument.light
            assert light is not None
            await light.on()
            await hsi.scan(hsi.default_plan(lines=4), tmp_path / "left.zarr", target="dark")
            assert light.level == 0

    run_virtual(main())
    assert float(scanhsi.open_cube(tmp_path / "left.zarr")["cube"].mean()) < 200

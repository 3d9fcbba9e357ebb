"""An instrument with a light: on for scans and white references, off between them, and left off for dark ones."""

from __future__ import annotations

from pathlib import Path

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.engine import Progress, ScanControl
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


def test_a_scan_that_was_stopped_goes_on_in_the_light(tmp_path: Path) -> None:
    cube = tmp_path / "cube.zarr"

    async def main(resuming: bool) -> scanhsi.ScanReport:
        async with scanhsi.open_instrument(load_instrument("sensors2019", LIT)) as hsi:
            control = ScanControl()

            def stop_soon(progress: Progress) -> None:
                if progress.taken >= 3:
                    control.stop.set()

            plan = hsi.default_plan(lines=30, exposure="500 ms")
            report = await (
                hsi.resume(cube) if resuming else hsi.scan(plan, cube, control=control, on_progress=stop_soon)
            )
            assert hsi.instrument.light is not None
            assert hsi.instrument.light.level == 0
            return report

    stopped = run_virtual(main(False))
    assert 0 < stopped.stored < 30
    assert run_virtual(main(True)).stored == 30
    lines = scanhsi.open_cube(cube)["cube"]
    means = lines.mean([name for name in lines.dims if name != "line"])
    assert float(means.min()) > 0.5 * float(means.max())

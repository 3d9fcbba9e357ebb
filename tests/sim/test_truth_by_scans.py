"""Simulated scans, from the engine to the cube in virtual time, show the instrument that `truth` tells of."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scanhsi
from scanhsi.calibration.backlash import backlash_steps
from scanhsi.calibration.dark import fit_dark
from scanhsi.calibration.slanted import displacements
from scanhsi.clock import run_virtual
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim import Truth, truth
from scanhsi_sim.options import ActuatorOptions, CameraOptions

FULL_SCALE = 4095


def instrument(shape: tuple[int, int], changes: Mapping[str, object]) -> InstrumentConfig:
    """The one with all errors on, with a smaller sensor."""
    bands, samples = shape
    small: dict[str, object] = {
        "camera.bands": bands,
        "camera.samples": samples,
        "roi.bands": bands,
        "roi.samples": samples,
        "roi.sample_offset": 0,
        "camera.optics.wavelength_nm": [600.0, 2.68],
        "camera.exposure_range_s": [1e-4, 2.0],
        "limits.exposure": ["0.1 ms", "2 s"],
        "actuator.home_s": 0.0,
    }
    return load_instrument("characterise", small | dict(changes))


def truth_of(config: InstrumentConfig) -> Truth:
    camera, actuator = config.camera.options, config.actuator.options
    assert isinstance(camera, CameraOptions)
    assert isinstance(actuator, ActuatorOptions)
    return truth(camera, actuator)


def scans(
    config: InstrumentConfig, folder: Path, plans: list[dict[str, Any]], pause_s: float = 0
) -> list[NDArray[Any]]:
    """Cubes (band, line, sample) of some plans, one after the other."""

    async def main() -> None:
        async with scanhsi.open_instrument(config) as hsi:
            for number, plan in enumerate(plans):
                await hsi.scan(hsi.default_plan(pixel_format="Mono12", **plan), folder / f"{number}.zarr")
                await asyncio.sleep(pause_s)

    run_virtual(main())
    return [scanhsi.open_cube(folder / f"{number}.zarr")["cube"].values for number in range(len(plans))]


def test_dark_scans_give_dark_current_offset_and_hot_pixels(tmp_path: Path) -> None:
    changes = {"camera.scene": "dark", "camera.sensor.hot_per_million": 1500}
    config = instrument((64, 96), changes)
    exposures = (0.01, 0.05, 0.2, 0.5, 0.8, 1.2, 1.6, 2.0)
    cubes = scans(config, tmp_path, [{"lines": 12, "exposure": f"{exposure} s"} for exposure in exposures])
    frames = [(exposure, cube[:, line]) for exposure, cube in zip(exposures, cubes, strict=True) for line in range(12)]
    found, real = fit_dark(frames, saturation=FULL_SCALE), truth_of(config)
    gain = real.gain()
    straight = ~real.nonlinear & (real.dark(2.0) < 0.9 * FULL_SCALE)
    deviation = (found.rate / gain - real.dark_e_per_s) / (found.rate_sigma / gain)
    level = (found.offset / gain - real.offset_e) / (found.offset_sigma / gain)
    assert (np.abs(deviation[straight]) < 3).mean() > 0.994
    assert (np.abs(level[straight]) < 3).mean() > 0.994
    assert deviation[straight].std() == pytest.approx(1, rel=0.06)
    assert found.hot[real.hot].all()
    assert (found.hot & ~real.hot).mean() < 3e-4  # of 6144 pixels, one
    assert found.nonlinear[real.nonlinear].all()
    assert real.hot.sum() == 9
    assert real.nonlinear.sum() == 2


def test_scans_both_ways_show_the_backlash(tmp_path: Path) -> None:
    quiet = {"camera.scene": "amsler", "actuator.mirror.jitter_steps": 0.0, "camera.target.turn_deg": 20.0}
    config = instrument((4, 300), quiet)
    up, down = scans(
        config, tmp_path, [{"lines": 160, "step": 1, "start": -80}, {"lines": 160, "step": -1, "start": 79}]
    )
    upwards, downwards = (cube[1].astype(float) for cube in (up, down[:, ::-1]))
    # A mirror that lags on its way down sees what it saw at higher steps on its way up.
    assert backlash_steps(upwards, downwards) == pytest.approx(truth_of(config).mirror.backlash_steps, abs=0.1)
    without = instrument((4, 300), quiet | {"actuator.mirror.backlash_steps": 0.0})
    (tmp_path / "without").mkdir()
    up, down = scans(
        without,
        tmp_path / "without",
        [{"lines": 160, "step": 1, "start": -80}, {"lines": 160, "step": -1, "start": 79}],
    )
    assert abs(backlash_steps(up[1].astype(float), down[1, ::-1].astype(float))) < 0.05


def test_the_slanted_lines_show_the_jitter_of_a_scan(tmp_path: Path) -> None:
    config = instrument(
        (4, 600), {"camera.scene": "slanted-lines", "actuator.mirror.misalignment_steps": 0.0, "scan.lines": 300}
    )
    (cube,) = scans(config, tmp_path, [{"step": 1, "exposure": "30 ms"}])
    found = displacements(cube[1].astype(float), float(np.tan(np.deg2rad(10))), 0.1)
    line = np.arange(len(found))
    bow = np.polynomial.Polynomial.fit(line, found, 3)(line)  # of the tangent; not the jitter's
    assert np.std(found - bow) == pytest.approx(truth_of(config).jitter_mm, rel=0.1)


def test_a_cold_lamp_is_seen_to_settle(tmp_path: Path) -> None:
    steady = {"camera.scene": "cold-lamp", "camera.lamp.flicker": 0.0, "camera.sensor.shot_noise": False}
    config = instrument((32, 64), steady)
    plan = {"lines": 2, "exposure": "10 ms"}
    cubes = scans(config, tmp_path, [plan] * 4, pause_s=120)
    real = truth_of(instrument((32, 64), steady | {"camera.lamp.on_before_s": 0.0}))
    levels = np.array([cube.mean() - real.dark(0.01).mean() for cube in cubes])
    expected = np.array([real.lamp_level(120.0 * number) for number in range(4)])
    np.testing.assert_allclose(levels / levels[-1], expected / expected[-1], rtol=2e-3)
    assert levels[0] / levels[-1] > 1.05


def test_two_scans_have_their_own_noise_and_a_repetition_has_the_same(tmp_path: Path) -> None:
    config = instrument((32, 64), {"camera.scene": "tile-50"})
    runs: list[list[NDArray[Any]]] = []
    for name in ("once", "again"):
        (tmp_path / name).mkdir()
        runs.append(scans(config, tmp_path / name, [{"lines": 3}] * 2))
    np.testing.assert_array_equal(runs[0], runs[1])
    first, second = (cube.astype(float) for cube in runs[0])
    mean = (first.mean(axis=1) + second.mean(axis=1)) / 2
    noises = [(cube - mean[:, None]).ravel() for cube in (first, second)]
    assert abs(np.corrcoef(*noises)[0, 1]) < 0.4  # common to both is only the mean that was taken away
    assert not np.array_equal(first, second)

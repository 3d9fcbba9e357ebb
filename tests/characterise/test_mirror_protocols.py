"""Backlash and repeatability from simulated acquisitions, against the mirror's truth; the same from the cubes that were kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi.calibration.backlash import Backlash
from scanhsi.calibration.repeatability import Repeatability
from scanhsi.calibration.result import load
from scanhsi.characterise.mirror_from_cubes import backlash_from_cubes, repeatability_from_cubes
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import CalibrationError
from scanhsi.instrument import load_instrument

NARROW = {"roi.samples": 240, "roi.bands": 3, "roi.sample_offset": 904, "roi.band_offset": 480}
EXPOSURE_S = 0.04
PLAY, JITTER = 2.4, 0.876  # steps, of the instrument `characterise`


def test_backlash_is_found_within_a_tenth_of_a_step(tmp_path: Path) -> None:
    steady = load_instrument("characterise", {**NARROW, "actuator.mirror.jitter_steps": 0.2})

    async def main() -> Backlash:
        async with scanhsi.open_instrument(steady) as hsi:
            return await hsi.calibrate.backlash(tmp_path / "backlash.nc", half_mm=25.0, runs=1, exposure_s=EXPOSURE_S)

    found = run_virtual(main())
    assert abs(found.lag_steps - PLAY) < 0.1
    assert found.lag_sigma_steps < 0.05
    assert load(Backlash, tmp_path / "backlash.nc").lag_steps == found.lag_steps
    cubes = sorted((tmp_path / "backlash-cubes").iterdir())
    assert backlash_from_cubes(cubes[::-1]).lag_steps == found.lag_steps  # cubes say which way they went
    with pytest.raises(CalibrationError, match="as many scans upwards as downwards"):
        backlash_from_cubes(cubes[:1])


def test_jitter_shows_in_the_error_of_the_backlash() -> None:
    async def main() -> Backlash:
        async with scanhsi.open_instrument(load_instrument("characterise", NARROW)) as hsi:
            return await hsi.calibrate.backlash(half_mm=25.0, runs=1, exposure_s=EXPOSURE_S)

    found = run_virtual(main())
    assert 0.05 < found.lag_sigma_steps < 0.2  # two jitters over 219 lines: 0.084
    assert abs(found.lag_steps - PLAY) < 3 * found.lag_sigma_steps


def test_repeatability_is_that_of_jitter_and_play(tmp_path: Path) -> None:
    async def main() -> Repeatability:
        async with scanhsi.open_instrument(load_instrument("characterise", NARROW)) as hsi:
            return await hsi.calibrate.repeatability(tmp_path / "r.nc", exposure_s=EXPOSURE_S)

    found = run_virtual(main())
    assert (found.runs, len(found.position_step)) == (5, 11)
    assert abs(found.sigma_steps - JITTER) < 3 * found.sigma_error_steps
    assert abs(found.reversal_steps - PLAY) < 3 * found.reversal_sigma_steps
    assert found.repeatability_steps > PLAY + 4 * JITTER
    assert abs(found.step_mm - 0.229) < 0.001
    again = repeatability_from_cubes(sorted((tmp_path / "r-cubes").iterdir()))
    np.testing.assert_allclose(again.reversal_steps, found.reversal_steps)

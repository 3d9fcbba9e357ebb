"""Each effect of the sensor shows, with the size asked for; measured by the calibrations where they fit."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi.calibration.photon_transfer import FlatPair, photon_transfer
from scanhsi.calibration.result import Provenance
from scanhsi_sim import CameraOptions, truth
from scanhsi_sim.effects import SensorOptions
from scanhsi_sim.sensor import Sensor

SHAPE = (96, 160)
NONE = SensorOptions(shot_noise=False, read_noise_e=0, prnu=0, dark_e_per_s=0, dark_spread=0, hot_per_million=0)


@cache
def sensor(options: SensorOptions, seed: int = 2) -> Sensor:
    return Sensor(SHAPE, seed, options)


def shoot(
    options: SensorOptions,
    electrons: float,
    *,
    exposure_s: float = 0.1,
    index: int = 0,
    acquisition: int = 0,
    gain_db: float = 0.0,
    bits: int = 12,
) -> NDArray[np.float64]:
    columns = np.full((SHAPE[0], 1), electrons / exposure_s, np.float32)
    weights = np.ones((1, SHAPE[1]), np.float32)
    frame = sensor(options).expose(
        columns,
        weights,
        exposure_s=exposure_s,
        gain_db=gain_db,
        offset=(0, 0),
        bits=bits,
        index=index,
        acquisition=acquisition,
    )
    return frame.astype(np.float64)


def with_(**changes: object) -> SensorOptions:
    return SensorOptions.model_validate(NONE.model_dump() | changes)


def test_without_effects_all_pixels_read_the_same_every_time() -> None:
    counts = shoot(NONE, 5000)
    assert np.ptp(counts) == 0
    assert counts[0, 0] == round(5100 * 4095 / 13_500)
    np.testing.assert_array_equal(counts, shoot(NONE, 5000, index=9, acquisition=3))


@pytest.mark.parametrize("gain_db", [0.0, 6.0])
def test_photon_transfer_finds_the_sensor(gain_db: float) -> None:
    """Gain within 2 %, read noise and full well within 3 %, PRNU and DSNU within 5 %: full well below the ADC's full scale."""
    full_scale = 15_000 * 10 ** (gain_db / 20)
    options = with_(shot_noise=True, read_noise_e=13, prnu=0.01, dsnu_e=6, full_scale_e=full_scale, dark_e_per_s=125)
    pairs = [
        FlatPair(
            exposure_s,
            *(
                np.stack(
                    [
                        shoot(
                            options,
                            rate * exposure_s,
                            exposure_s=exposure_s,
                            index=index,
                            acquisition=n,
                            gain_db=gain_db,
                        )
                        for index in (0, 1)
                    ]
                )
                for n, rate in enumerate((1.0e5, 0.0))
            ),
        )
        for exposure_s in np.linspace(0.005, 0.165, 33).tolist()
    ]
    found = photon_transfer(pairs, Provenance())
    gain = sensor(options).counts_per_electron(gain_db, 12)
    assert gain == pytest.approx(4095 / 15_000)
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert found.read_noise_e == pytest.approx(13, rel=0.03)
    assert found.full_well_e == pytest.approx(13_500, rel=0.05)
    assert found.prnu == pytest.approx(0.01, rel=0.05)
    assert found.dsnu_e == pytest.approx(6, rel=0.05)


def test_a_full_well_below_full_scale_is_a_plateau() -> None:
    options = with_(shot_noise=True, read_noise_e=13, full_scale_e=15_000)
    plateau = shoot(options, 40_000)
    assert plateau.mean() == pytest.approx(13_600 * 4095 / 15_000, abs=0.5)
    assert plateau.max() < 4095
    assert plateau.std() == pytest.approx(13 * 4095 / 15_000, rel=0.03)  # the shot noise is gone, that of reading stays


def test_dark_current_has_its_mean_and_spread() -> None:
    dark = sensor(with_(dark_e_per_s=200, dark_spread=0.5)).dark_e_per_s
    assert dark.mean() == pytest.approx(200, rel=0.02)
    assert np.log(dark).std() == pytest.approx(0.5, rel=0.02)
    options = with_(dark_e_per_s=200, dark_spread=0.5, full_scale_e=4095)
    rates = (shoot(options, 0, exposure_s=2) - shoot(options, 0, exposure_s=1)) / 1
    np.testing.assert_allclose(rates, sensor(options).dark_e_per_s, atol=1.1)


def test_black_level_differs_from_pixel_to_pixel() -> None:
    options = with_(dsnu_e=20, full_scale_e=4095)
    np.testing.assert_allclose(shoot(options, 0), sensor(options).offset_e, atol=0.51)
    assert sensor(options).offset_e.std() == pytest.approx(20, rel=0.03)


def test_hot_pixels_are_as_many_as_asked_and_some_level_off() -> None:
    hot = {"hot_per_million": 2000, "hot_e_per_s": (1000, 5000), "hot_nonlinear": 0.25, "hot_nonlinear_s": 0.3}
    options = with_(**hot, full_scale_e=16_000)
    chip = sensor(options)
    count = round(2000e-6 * SHAPE[0] * SHAPE[1])
    assert (int(chip.hot.sum()), int(chip.nonlinear.sum())) == (count, round(count / 4))
    assert not (chip.nonlinear & ~chip.hot).any()
    rates = [(shoot(options, 0, exposure_s=t) - shoot(options, 0, exposure_s=0.01)) / t for t in (0.1, 2.0)]
    assert not (rates[0] > 50)[~chip.hot].any()
    straight = chip.hot & ~chip.nonlinear
    assert np.median(rates[1][straight] / rates[0][straight]) == pytest.approx(1, rel=0.15)
    assert np.median(rates[1][chip.nonlinear] / rates[0][chip.nonlinear]) < 0.4


def test_noise_belongs_to_the_frame_the_acquisition_and_the_exposure() -> None:
    """And to nothing else: not to what was rendered before."""
    options = with_(shot_noise=True, read_noise_e=13)
    first = shoot(options, 3000, index=4, acquisition=1)
    others = [
        shoot(options, 3000, index=5, acquisition=1),
        shoot(options, 3000, index=4, acquisition=2),
        shoot(options, 3000, index=4, acquisition=1, exposure_s=0.2),
    ]
    np.testing.assert_array_equal(first, shoot(options, 3000, index=4, acquisition=1))
    noise = first - first.mean()
    for other in others:
        assert abs(np.corrcoef(noise.ravel(), (other - other.mean()).ravel())[0, 1]) < 0.05
    again = Sensor(SHAPE, 2, options)
    np.testing.assert_array_equal(sensor(options).response, again.response)
    assert not np.array_equal(sensor(options).dark_e(1), Sensor(SHAPE, 3, SensorOptions()).dark_e(1))


def test_noise_of_many_frames_is_normal_and_independent_pixel_by_pixel() -> None:
    """The bank that the noise is taken from must not show: variances follow chi-square, means fall with the root of frames."""
    options = with_(read_noise_e=40, full_scale_e=4095, offset_e=1000)
    frames = np.stack([shoot(options, 0, index=index) for index in range(60)])
    variance = frames.var(axis=0, ddof=1)
    read = 40**2 + 1 / 12
    assert variance.mean() == pytest.approx(read, rel=0.01)
    assert variance.std() == pytest.approx(read * np.sqrt(2 / 59), rel=0.05)
    assert frames.mean(axis=0).std() == pytest.approx(np.sqrt(read / 60), rel=0.03)
    whole = frames.mean(axis=(1, 2))
    assert whole.std(ddof=1) == pytest.approx(np.sqrt(read / frames[0].size), rel=0.35)
    z = (frames - 1000) / np.sqrt(read)
    assert abs((z**3).mean()) < 0.02
    assert (z**4).mean() == pytest.approx(3, abs=0.03)
    lines = frames - frames.mean(axis=0)
    for shift, axis in ((1, 1), (1, 2), (7, 2)):
        assert abs((lines * np.roll(lines, shift, axis)).mean()) / read < 0.01


def test_truth_is_what_is_measured() -> None:
    options = with_(dark_e_per_s=150, dark_spread=0.3, dsnu_e=10, hot_per_million=500, hot_nonlinear=0.5)
    camera = CameraOptions(bands=SHAPE[0], samples=SHAPE[1], seed=2, sensor=options)
    real = truth(camera)
    for exposure_s in (0.02, 1.5):
        seen = shoot(options, 0, exposure_s=exposure_s, gain_db=6, bits=12)
        np.testing.assert_allclose(seen, real.dark(exposure_s, gain_db=6), atol=0.51)
    assert real.gain(6.0206, 8) == pytest.approx(2 * 255 / 13_500, rel=1e-4)
    assert real.full_scale_e == 13_500
    assert real.reflectance is None

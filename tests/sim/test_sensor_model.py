"""The sensor's statistics: photon transfer, read noise, dark current, full well."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi_sim.scenes import Geometry, load_scene
from scanhsi_sim.sensor import DARK_E_PER_S, FULL_WELL_E, OFFSET_E, PRNU, READ_NOISE_E, Sensor

SHAPE = (64, 96)
E_PER_DN = FULL_WELL_E / 4095


@cache
def sensor() -> Sensor:
    return Sensor(SHAPE, seed=4)


def frames(
    electrons: float, count: int = 200, *, exposure_s: float = 0.05, gain_db: float = 0.0, bits: int = 12
) -> NDArray[np.float64]:
    """Frames of a flat field of so many electrons, (count, bands, samples)."""
    columns = np.full((SHAPE[0], 1), electrons / exposure_s, np.float32)
    weights = np.ones((1, SHAPE[1]), np.float32)
    shots = [
        sensor().expose(columns, weights, exposure_s=exposure_s, gain_db=gain_db, offset=(0, 0), bits=bits, index=index)
        for index in range(count)
    ]
    return np.stack(shots).astype(np.float64)


@pytest.mark.parametrize("electrons", [500, 3000, 9000])
def test_shot_noise_is_the_root_of_the_signal(electrons: float) -> None:
    """Photon transfer: the temporal variance of a pixel is its mean plus the read noise squared, in electrons."""
    shots = frames(electrons) * E_PER_DN
    variance = np.median(shots.var(axis=0, ddof=1))
    assert shots.mean() == pytest.approx(electrons + OFFSET_E + DARK_E_PER_S * 0.05, rel=0.01)
    quantisation = E_PER_DN**2 / 12
    assert variance == pytest.approx(electrons + READ_NOISE_E**2 + quantisation, rel=0.03)


def test_read_noise_is_what_is_left_in_the_dark() -> None:
    shots = frames(0) * E_PER_DN
    assert np.sqrt(np.median(shots.var(axis=0, ddof=1))) == pytest.approx(READ_NOISE_E, rel=0.05)
    assert shots.min() > 0  # the black level keeps the noise from being cut off


def test_noise_of_frames_and_pixels_is_independent() -> None:
    shots = frames(2000, 100)
    noise = shots - shots.mean(axis=0)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise[:, :, :-1].ravel(), noise[:, :, 1:].ravel())[0, 1]) < 0.02


def test_response_differs_by_one_percent() -> None:
    shots = frames(9000).mean(axis=0) * E_PER_DN - OFFSET_E
    assert shots.std() / shots.mean() == pytest.approx(PRNU, rel=0.15)


def test_dark_signal_is_linear_in_exposure() -> None:
    means = [np.median(frames(0, 60, exposure_s=t).mean(axis=0)) * E_PER_DN for t in (0.1, 1.0, 2.0)]
    rate = (means[2] - means[0]) / 1.9
    assert rate == pytest.approx(DARK_E_PER_S, rel=0.15)
    assert means[1] == pytest.approx((means[0] * 1.0 + means[2] * 0.9) / 1.9, abs=2)


def test_there_are_a_few_hot_pixels() -> None:
    dark = Sensor((1088, 1200), seed=0)
    shot = dark.expose(
        np.zeros((1088, 1), np.float32),
        np.ones((1, 1200), np.float32),
        exposure_s=0.5,
        gain_db=0,
        offset=(0, 0),
        bits=12,
        index=0,
    )
    assert 5 < (shot > 1000).sum() < 100


def test_full_well_and_adc_end_somewhere() -> None:
    assert (frames(40_000, 3) == 4095).mean() > 0.3
    assert frames(40_000, 3, bits=8).max() == 255
    assert frames(40_000, 3, gain_db=-6)[0].mean() == pytest.approx(
        (FULL_WELL_E + OFFSET_E) / E_PER_DN * 10**-0.3, rel=0.01
    )


def test_gain_scales_signal_and_noise() -> None:
    plain, amplified = frames(1000, 50), frames(1000, 50, gain_db=6.0206)
    assert amplified.mean() / plain.mean() == pytest.approx(2, rel=0.01)
    assert amplified.std(axis=0).mean() / plain.std(axis=0).mean() == pytest.approx(2, rel=0.03)


def test_eight_bits_are_the_upper_eight() -> None:
    assert frames(6000, 50, bits=8).mean() / frames(6000, 50).mean() == pytest.approx(255 / 4095, rel=0.01)


def test_white_and_dark_tiles() -> None:
    settings = {"exposure_s": 0.05, "gain_db": 0.0, "shape": (1088, 64), "offset": (0, 992), "bits": 12, "index": 0}
    white = load_scene("white", Geometry()).render(0, 0, **settings).astype(float)
    dark = load_scene("dark", Geometry()).render(0, 0, **settings).astype(float)
    assert white.mean(axis=1).max() == pytest.approx(0.6 * 4095, rel=0.03)
    assert np.median(dark) == pytest.approx((OFFSET_E + 6) / E_PER_DN, abs=2)
    assert (white[10:1080] > dark[10:1080]).mean() > 0.99


def test_a_region_is_that_part_of_the_whole() -> None:
    """The fixed pattern and the optics belong to the sensor, not to the region read out."""
    scene = load_scene("white", Geometry(sensor=(128, 96)))
    common = {"exposure_s": 0.05, "gain_db": 0.0, "bits": 12}
    whole = np.mean([scene.render(0, 0, shape=(128, 96), offset=(0, 0), index=i, **common) for i in range(40)], 0)
    part = np.mean([scene.render(0, 0, shape=(30, 40), offset=(20, 8), index=i, **common) for i in range(40)], 0)
    np.testing.assert_allclose(part[:, 1:-1], whole[20:50, 9:47], rtol=0.05, atol=12)

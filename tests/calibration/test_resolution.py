import math

import numpy as np
import pytest
from scipy import special

from scanhsi.calibration.resolution import bar_contrast, edge_response
from scanhsi.calibration.result import Provenance
from scanhsi.devices.errors import CalibrationError

PITCH = 0.1


def slanted(sigma_mm: float, *, lines=120, samples=90, angle_deg=5.0, noise=0.0, box=True):
    """An edge blurred by a Gaussian and, along the slit, by square pixels; analytic."""
    rng = np.random.default_rng(1)
    slope = math.tan(math.radians(angle_deg))
    across = (np.arange(samples)[None, :] - samples / 2 - slope * (np.arange(lines)[:, None] - lines / 2)) * PITCH
    scale = math.sqrt(2) * sigma_mm
    if not box:
        return 100 + 800 * 0.5 * (1 + special.erf(across / scale)) + rng.normal(0, noise, across.shape)

    def integral(place):
        z = place / scale
        return scale * (z * special.erf(z) + np.exp(-(z**2)) / math.sqrt(math.pi))

    mean = (integral(across + PITCH / 2) - integral(across - PITCH / 2)) / PITCH
    return 100 + 400 * (1 + mean) + rng.normal(0, noise, across.shape)


@pytest.mark.parametrize("sigma_mm", [0.06, 0.1, 0.2])
@pytest.mark.parametrize("axis", ["line", "sample"])
def test_transfer_function_against_the_analytic_curve(sigma_mm: float, axis):
    picture = slanted(sigma_mm, noise=2.0)
    found = edge_response(picture.T if axis == "line" else picture, axis, PITCH, Provenance())
    frequency = found.frequency_per_mm
    truth = np.exp(-2 * (math.pi * sigma_mm * frequency) ** 2) * np.sinc(frequency * PITCH)
    np.testing.assert_allclose(found.mtf, truth, atol=0.025)
    assert found.mtf50_per_mm == pytest.approx(np.interp(-0.5, -truth, frequency), rel=0.03)
    assert found.angle_deg == pytest.approx(5.0, abs=0.1)


def test_the_slant_of_pixels_that_are_not_square_is_that_on_the_target():
    """Rows 0.228 mm apart, pixels of 0.1 mm: 5 degrees on the target are 11 in pixels."""
    stretched = slanted(0.1, angle_deg=math.degrees(math.atan(math.tan(math.radians(5)) * 0.228 / PITCH)))
    found = edge_response(stretched, "sample", PITCH, Provenance(), across_mm=0.228)
    assert found.angle_deg == pytest.approx(5.0, abs=0.1)
    square = edge_response(stretched, "sample", PITCH, Provenance())
    assert square.angle_deg == pytest.approx(11.3, abs=0.2)
    assert square.mtf50_per_mm / found.mtf50_per_mm == pytest.approx(
        math.cos(math.radians(5)) / math.cos(math.radians(11.28)), rel=1e-3
    )


def test_jitter_alone_as_the_paper_would_have_had_it():
    found = edge_response(slanted(0.2, box=False), "sample", PITCH, Provenance())
    for bar_mm, expected in ((2.0, 0.952), (1.0, 0.821), (0.5, 0.454), (0.3, 0.112)):
        there = float(np.interp(1 / (2 * bar_mm), found.frequency_per_mm, found.mtf))
        assert there == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    ("picture", "why"),
    [
        (slanted(0.1, angle_deg=0.2), "slanted by"),
        (slanted(0.1)[:10], "20 rows"),
        (np.where(slanted(0.1) > 500, np.nan, 100.0), "no numbers"),
        (np.random.default_rng(2).normal(100, 5, (60, 60)), r"no edge stands out|slanted by"),
        (np.ones((60, 60)), "no edge"),
    ],
)
def test_what_is_no_edge_is_refused(picture, why: str):
    with pytest.raises(CalibrationError, match=why):
        edge_response(picture, "sample", PITCH, Provenance())


def bars(width_mm: float, sigma_mm: float, *, pitch=0.05):
    place = np.arange(0, 6 * width_mm, pitch)
    wave = np.sin(math.pi * place / width_mm + 0.4)
    square = sum(
        4
        / math.pi
        / order
        * math.exp(-2 * (math.pi * sigma_mm * order / (2 * width_mm)) ** 2)
        * np.sin(order * (math.pi * place / width_mm + 0.4))
        for order in range(1, 40, 2)
    )
    assert np.isfinite(wave).all()
    return width_mm, np.tile(500 + 400 * square, (8, 1))


def test_contrast_of_bars_follows_the_transfer_function():
    sigma = 0.2
    widths = (2.0, 1.0, 0.5, 0.3, 0.25)
    found = bar_contrast([bars(width, sigma) for width in widths], "sample", 0.05, Provenance(), black=100, white=900)
    expected = [math.exp(-2 * (math.pi * sigma / (2 * width)) ** 2) for width in widths]
    np.testing.assert_allclose(found.contrast, expected, atol=0.02)
    assert found.resolved_mm == 0.5


def test_noise_is_no_contrast():
    rng = np.random.default_rng(3)
    noise = [(width, 500 + rng.normal(0, 40, (6, 80))) for width in (1.0, 0.5)]
    found = bar_contrast(noise, "sample", 0.05, Provenance(), black=100, white=900)
    assert found.contrast.max() < 0.1
    assert math.isnan(found.resolved_mm)


def test_bars_that_cannot_be_told_are_refused():
    with pytest.raises(CalibrationError, match="cannot be told in 3 pixels"):
        bar_contrast([(1.0, np.ones((5, 3)))], "sample", 0.05, Provenance())
    with pytest.raises(CalibrationError, match="no elements"):
        bar_contrast([], "sample", 0.05, Provenance())

"""Targets against their analytic truth, with the calibrations as measuring devices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi.calibration.geometry import Geometry as Model
from scanhsi.calibration.geometry import fit_geometry
from scanhsi.calibration.resolution import Axis, bar_contrast, edge_response
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.slanted import displacements
from scanhsi_sim.effects import LampOptions, OpticsOptions, SensorOptions, Setup, TargetOptions
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.scenes import load_scene
from scanhsi_sim.scenes.edges import Blur, Footprint
from scanhsi_sim.scenes.targets import amsler
from scanhsi_sim.scenes.usaf import usaf_elements

Floats = NDArray[np.float64]

SILENT = SensorOptions(
    shot_noise=False, read_noise_e=0, prnu=0, dark_e_per_s=0, hot_per_million=0, full_well_e=1e6, full_scale_e=9000
)
PLAIN = OpticsOptions(wavelength_nm=(600.0, 2.68), smile_px=0, keystone_px=0, vignetting=0)
SETUP = Setup(
    Geometry(sensor=(4, 600), pixel_mm=0.1, distance_mm=348.73), 1, SILENT, PLAIN, LampOptions(white_e_per_s=160e3)
)
PITCH_MM = 0.2282


def picture(scene: str, setup: Setup, steps: range | NDArray[np.float64]) -> Floats:
    """One band, (line, sample), electrons of a tenth of a count."""
    view = load_scene(scene, setup=setup)
    shape = (4, setup.geometry.sensor[1])
    lines = [
        view.render(float(step), float(step), exposure_s=0.05, gain_db=0, shape=shape, offset=(0, 0), bits=12, index=0)[
            1
        ]
        for step in steps
    ]
    black = 100 / 9000 * 4095
    return np.stack(lines).astype(np.float64) - black


@pytest.mark.parametrize("blur", [Blur(0.1, 0.3, 0.2), Blur(1e-4, 0.3, 0.0), Blur(0.2, 0.0, 0.0), Blur(0.05, 0.4, 0.4)])
def test_an_edge_is_the_convolution_of_a_step_with_a_gaussian_and_two_boxes(blur: Blur) -> None:
    fine = np.arange(-3, 3, 1e-3)
    values = (fine > 0).astype(float)
    for width in (blur.wide, blur.narrow):
        half = round(width / 2 / 1e-3)
        values = np.convolve(np.pad(values, half, mode="edge"), np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
    kernel = np.exp(-((np.arange(-1.2, 1.2005, 1e-3) / max(blur.sigma, 2e-4)) ** 2) / 2)
    values = np.convolve(np.pad(values, len(kernel) // 2, mode="edge"), kernel / kernel.sum(), "valid")
    np.testing.assert_allclose(blur.edge(fine)[100:-100], values[: len(fine)][100:-100], atol=6e-3)


def test_a_grating_repeats_and_keeps_its_share_whatever_the_blur() -> None:
    depth = np.linspace(-12, 12, 4801)[:-1]
    for blur in (Blur(1e-4, 0.1, 0.0), Blur(0.4, 1.0, 0.3)):
        lines = blur.grating(depth, 0.6, 2.0)
        assert lines.mean() == pytest.approx(0.3, abs=1e-3)
        np.testing.assert_allclose(lines[:400], lines[400:800], atol=1e-9)


@pytest.mark.parametrize("axis", ["sample", "line"])
def test_the_slanted_edge_has_the_transfer_of_lens_pixel_and_slit(axis: Axis) -> None:
    optics = PLAIN.model_copy(update={"blur_px": 1.2, "slit_px": 3.0})
    seen = picture("slanted-edge", replace(SETUP, optics=optics), range(-150, 151))
    x = (np.arange(600) - 299.5) * 0.1
    y = -np.arange(-150, 151) * PITCH_MM
    if axis == "sample":
        part = seen[np.abs(y) < 12][:, np.abs(x + 20) < 7]
        pitch, box, other = 0.1, 0.1, 0.3
    else:
        part = seen[np.abs(y - 20) < 7][:, np.abs(x) < 12]
        pitch, box, other = PITCH_MM, 0.3, 0.1
    found = edge_response(part, axis, pitch, Provenance())
    f, slant = found.frequency_per_mm, np.deg2rad(5)
    expected = (
        np.exp(-2 * (np.pi * 0.12 * f) ** 2) * np.sinc(f * box * np.cos(slant)) * np.sinc(f * other * np.sin(slant))
    )
    used = f < min(2.0, 0.45 / pitch)
    np.testing.assert_allclose(found.mtf[used], expected[used], atol=0.02)
    pixels = (
        PITCH_MM / 0.1 if axis == "sample" else 0.1 / PITCH_MM
    )  # the slant is counted in pixels, which are not square
    assert np.tan(np.deg2rad(abs(found.angle_deg))) == pytest.approx(np.tan(slant) * pixels, rel=0.02)


def test_usaf_elements_have_the_measures_of_the_standard() -> None:
    elements = {(each.group, each.element): each for each in usaf_elements()}
    assert len(elements) == 24
    assert [elements[group, 1].bar_mm for group in (-2, -1, 0, 1)] == [2.0, 1.0, 0.5, 0.25]
    assert elements[0, 4].bar_mm == pytest.approx(0.5 / 2**0.5)
    boxes = [(each.bar_mm, place) for each in elements.values() for place in (each.upright, each.lying)]
    for index, (width, (x, y)) in enumerate(boxes):
        for other, (u, v) in boxes[index + 1 :]:
            assert max(abs(x - u), abs(y - v)) >= 2.5 * (width + other) + min(width, other)  # none touches another


def test_usaf_bars_lose_the_contrast_that_the_optics_take() -> None:
    optics = PLAIN.model_copy(update={"blur_px": 1.5, "slit_px": 4.0})
    steps = np.arange(-180, 181, 0.5)
    seen = picture("usaf", replace(SETUP, optics=optics), steps)
    geometry = SETUP.geometry
    y = np.array([geometry.y_mm(step) for step in steps])
    x = (np.arange(600) - 299.5) * 0.1
    parts: dict[Axis, list[tuple[float, Floats]]] = {"sample": [], "line": []}
    for each in usaf_elements()[:14]:
        for axis in parts:
            u, v = each.upright if axis == "sample" else each.lying
            across = 2.4 * each.bar_mm
            along = 1.5 * each.bar_mm
            reach = (across, along) if axis == "sample" else (along, across)
            part = seen[np.abs(y - v) < reach[1]][:, np.abs(x - u) < reach[0]]
            parts[axis].append((each.bar_mm, part))
    white = float(seen.max())
    for axis in parts:
        pitch, box = (0.1, 0.1) if axis == "sample" else (PITCH_MM / 2, 0.4)
        found = bar_contrast(parts[axis], axis, pitch, Provenance(), black=0.05 * white, white=white)
        f = 1 / (2 * found.bar_mm)
        expected = np.exp(-2 * (np.pi * 0.15 * f) ** 2) * np.sinc(f * box)
        np.testing.assert_allclose(found.contrast, expected, atol=0.12)
        assert np.all(np.diff(found.contrast[::2]) < 0.02)


def grid_lines(seen: Floats, steps: NDArray[np.float64]) -> Floats:
    """Centroids of the dark lines along the scan, in steps."""
    profile = 1 - seen / np.quantile(seen, 0.9)
    dark = profile > 0.4
    edges = np.flatnonzero(np.diff(dark.astype(int)))
    pairs = edges.reshape(-1, 2) if not dark[0] else edges[1:].reshape(-1, 2)
    return np.array([np.average(steps[a - 2 : b + 4], weights=profile[a - 2 : b + 4].clip(0)) for a, b in pairs])


def test_the_amsler_grid_gives_distance_normal_and_pitch() -> None:
    geometry = replace(SETUP.geometry, normal_step=7.3)
    steps = np.arange(-265.0, 280.0)
    between = picture("amsler", replace(SETUP, geometry=geometry), steps)[:, 325:334].mean(
        axis=1
    )  # off the upright lines
    lines = grid_lines(between, steps)
    start = Model(350, 0, 2 * np.pi / 19_200, 0.1, 299.5, Provenance())
    y = np.rint(geometry_y(geometry, lines) / 6) * 6
    found = fit_geometry(lines, y, start, Provenance())
    assert len(lines) >= 20
    assert found.distance_mm == pytest.approx(348.73, abs=0.15)
    assert found.normal_step == pytest.approx(7.3, abs=0.1)


def geometry_y(geometry: Geometry, steps: Floats) -> Floats:
    return np.array([geometry.y_mm(step) for step in steps])


def test_a_tilted_plane_is_that_of_the_calibration() -> None:
    """Two implementations of the same trigonometry."""
    geometry = Geometry(distance_mm=300, normal_step=-40, tilt_rad=0.1, pixel_mm=0.1)
    model = Model(300, -40, 2 * np.pi / 19_200, 0.1, 1023.5, Provenance(), tilt_rad=0.1)
    for step in (-700, -40, 0, 512.25):
        assert geometry.y_mm(step) == pytest.approx(float(model.y_mm(step)), abs=1e-9)
        assert geometry.x_mm(step, np.array([5], np.float32))[0] == pytest.approx(float(model.x_mm(5, step)), rel=1e-5)
        moved = (geometry.y_mm(step + 0.5) - geometry.y_mm(step - 0.5)) / (4 * np.pi / 19_200)
        assert -moved == pytest.approx(300 * geometry.stretched(step), rel=1e-5)


def test_a_turned_and_moved_target_is_turned_and_moved() -> None:
    options = TargetOptions(centre_mm=(3.0, -2.0), turn_deg=90 / 4)
    centre = Footprint(np.array([3.0]), -2.0, 0.01, 0.01, 0, 0)
    assert amsler(centre, options)[0] == pytest.approx(1)
    between = np.deg2rad(22.5 + 45)
    middle = Footprint(
        np.array([3 + 3 * 2**0.5 * np.cos(between)]), -2 + 3 * 2**0.5 * np.sin(between), 0.01, 0.01, 0, 0
    )
    assert amsler(middle, options)[0] == pytest.approx(0, abs=1e-6)


def test_slanted_lines_show_the_displacement_of_each_line() -> None:
    rng = np.random.default_rng(3)
    jitter = rng.normal(0, 0.876, 200)
    steps = np.arange(-100, 100) + jitter
    seen = picture("slanted-lines", SETUP, steps)
    found = displacements(seen, np.tan(np.deg2rad(10)), 0.1)
    expected = -jitter * PITCH_MM
    assert np.std(found) == pytest.approx(np.std(expected), rel=0.1)
    assert abs(np.corrcoef(found, expected)[0, 1]) > 0.98


def test_keystone_moves_an_edge_along_the_slit_and_nothing_else_does() -> None:
    """By as much as said, in either direction, at the first and the last band."""
    for keystone in (0.0, 0.6):
        optics = PLAIN.model_copy(update={"keystone_px": keystone, "blur_px": 1.0})
        view = load_scene(
            "slanted-edge", setup=replace(SETUP, geometry=replace(SETUP.geometry, sensor=(9, 600)), optics=optics)
        )
        frame = view.render(0, 0, exposure_s=0.05, gain_db=0, shape=(9, 600), offset=(0, 0), bits=12, index=0).astype(
            float
        )
        rise: Floats = np.diff(frame[:, 350:], axis=1)
        where = np.arange(rise.shape[1], dtype=np.float64) + 350.5
        place: Floats = rise @ where / rise.sum(axis=1)
        across = np.linspace(-1, 1, 600)[round(place[4])]
        np.testing.assert_allclose(place - place[4], keystone * across * np.linspace(-1, 1, 9), atol=0.03)

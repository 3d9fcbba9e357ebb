"""Lamp lines, tiles and patches as the spectrograph shows them: where, how wide, how bent, how bright."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi.devices.errors import ConfigError
from scanhsi_sim import CameraOptions, truth
from scanhsi_sim.effects import LampOptions, OpticsOptions, SensorOptions, Setup, TargetOptions
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.lamp import hgar_lines, settled
from scanhsi_sim.optics import wavelengths
from scanhsi_sim.scenes import COLD_LAMP, TILES, load_scene
from scanhsi_sim.scenes.surfaces import PATCH_PITCH_MM, patch_centre, patch_names, patches, tile_reflectance

Floats = NDArray[np.float64]

SILENT = SensorOptions(
    shot_noise=False, read_noise_e=0, prnu=0, dark_e_per_s=0, hot_per_million=0, full_well_e=1e6, full_scale_e=9000
)
SETUP = Setup(Geometry(sensor=(1088, 9), distance_mm=348.73), 1, SILENT, OpticsOptions(vignetting=0, keystone_px=0))
BLACK = 100 / 9000 * 4095


def frame(scene: str, setup: Setup = SETUP, *, step: float = 0, time_s: float = 0, index: int = 0) -> Floats:
    """(band, sample) counts above black."""
    return (
        load_scene(scene, setup=setup)
        .render(
            step,
            step,
            exposure_s=0.05,
            gain_db=0,
            shape=setup.geometry.sensor,
            offset=(0, 0),
            bits=12,
            index=index,
            time_s=time_s,
        )
        .astype(float)
        - BLACK
    )


def moments(column: Floats, centre: float, reach: int = 8) -> tuple[float, float]:
    """Centroid and standard deviation of a line, in bands."""
    bands = np.arange(round(centre) - reach, round(centre) + reach + 1)
    weight = column[bands].clip(0)
    mean = float(np.average(bands, weights=weight))
    return mean, float(np.sqrt(np.average((bands - mean) ** 2, weights=weight)))


def test_lines_of_the_lamp_stand_where_the_dispersion_puts_them() -> None:
    """Clean ones of paper.md 7.1, to a hundredth of a band (5 pm), with the width asked for."""
    real = truth(CameraOptions(bands=1088, samples=9, optics=SETUP.optics))
    seen = frame("hgar")[:, 4]
    for wavelength in (546.0750, 763.5106, 852.1442):
        expected = float(np.interp(wavelength, real.wavelength_nm, np.arange(1088)))
        centre, sigma = moments(seen, expected)
        assert centre == pytest.approx(expected, abs=0.03)
        assert sigma * 2.3548 == pytest.approx(real.lsf_fwhm_bands, rel=0.02)
    assert real.lsf_fwhm_bands * np.mean(np.diff(real.wavelength_nm)) == pytest.approx(2.9)


def test_the_list_of_lines_is_that_of_the_reference() -> None:
    lines = hgar_lines()
    assert sum(line.element == "Hg" for line in lines) == 10
    assert sum(line.element == "Ar" for line in lines) == 29
    assert {546.0750, 579.0670, 811.5310} <= {line.wavelength_nm for line in lines}


def test_smile_bends_lines_by_as_much_as_said_and_not_without() -> None:
    for smile in (0.0, 0.8, -1.0):
        optics = SETUP.optics.model_copy(update={"smile_px": smile})
        real = truth(CameraOptions(bands=1088, samples=9, optics=optics))
        seen = frame("hgar", replace(SETUP, optics=optics))
        middle = moments(seen[:, 4], np.interp(546.0750, real.wavelength_nm, np.arange(1088)))[0]
        bent = [moments(seen[:, sample], middle, 9)[0] - middle for sample in range(9)]
        np.testing.assert_allclose(bent, real.smile_bands, atol=0.02)


def test_a_wider_slit_takes_two_lines_for_one() -> None:
    """Dip between 794.8 and 800.6 nm, and none between 577 and 579: section 3.2 of the reference."""
    sharp = SETUP.optics.model_copy(update={"lsf_fwhm_nm": 1.5})
    for optics, resolved in ((SETUP.optics, False), (sharp, True)):
        column = frame("hgar", replace(SETUP, optics=optics))[:, 4]
        real = truth(CameraOptions(bands=1088, samples=9, optics=optics)).wavelength_nm
        left, right = (int(np.argmin(np.abs(real - nm))) for nm in (576.961, 579.067))
        assert (column[left + 1 : right].min() < 0.9 * min(column[left], column[right])) == resolved
        left, right = (int(np.argmin(np.abs(real - nm))) for nm in (794.8176, 800.6157))
        assert column[left:right].min() < 0.3 * column[left]


def test_the_wavelength_tile_absorbs_where_its_certificate_says(tmp_path: Path) -> None:
    real = truth(CameraOptions(scene="wavelength-tile", bands=1088, samples=9))
    assert real.reflectance is not None
    ratio = frame("wavelength-tile")[:, 4] / frame("white")[:, 4] * 0.99
    clear = (real.wavelength_nm > 420) & (real.wavelength_nm < 920)
    np.testing.assert_allclose(ratio[clear], real.reflectance[clear], atol=0.06)  # the slit fills the minima a little
    for nm in (586.5, 741.6, 804.9):
        near = np.abs(real.wavelength_nm - nm) < 6
        assert real.wavelength_nm[near][np.argmin(ratio[near])] == pytest.approx(nm, abs=1.2)

    own = tmp_path / "tile.csv"
    own.write_text("# mine\nwavelength_nm,reflectance\n300,0.2\n700,0.6\n1000,0.6\n")
    assert tile_reflectance(np.array([500.0, 800.0]), own) == pytest.approx([0.4, 0.6])
    own2 = tmp_path / "other.csv"
    own2.write_text("nm,transmission\n300,0.2\n1000,0.6\n")
    with pytest.raises(ConfigError, match="its columns are nm, transmission"):
        tile_reflectance(np.array([500.0]), own2)
    with pytest.raises(ConfigError, match="cannot be read"):
        tile_reflectance(np.array([500.0]), tmp_path / "none.csv")


def test_tiles_reflect_what_they_are_called() -> None:
    white = frame("white")[100:1000].mean()
    for name, reflectance in TILES.items():
        assert frame(name)[100:1000].mean() / white == pytest.approx(reflectance / 0.99, abs=3e-4)
    assert np.abs(frame("dark")).max() < 1


def test_patches_are_those_of_the_colour_checker() -> None:
    """Against colour-science, whose numbers they are; the chart is as the chart is, from dark skin to black."""
    theirs = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    nm = np.arange(380.0, 731.0, 10.0)
    assert patch_names() == tuple(name.replace(",", "") for name in theirs)
    np.testing.assert_allclose(patches(nm), np.stack([each.values for each in theirs.values()], axis=1), atol=1e-9)


def test_each_patch_is_seen_in_its_place() -> None:
    setup = replace(SETUP, geometry=Geometry(sensor=(1088, 1200), pixel_mm=0.1, distance_mm=348.73))
    wavelength = wavelengths(setup)
    bands = [int(np.argmin(np.abs(wavelength - nm))) for nm in (480, 560, 650)]
    for row in range(4):
        y = patch_centre(6 * row)[1]
        step = -np.arctan(y / 348.73) * 19_200 / (4 * np.pi)
        seen, white = frame("colour-checker", setup, step=step), frame("white", setup)
        for column in range(6):
            x = patch_centre(column)[0] * np.cos(np.arctan(y / 348.73)) / 0.1 + 599.5
            here = (bands, slice(round(x) - 20, round(x) + 20))
            found = seen[here].mean(axis=1) / white[here].mean(axis=1) * 0.99
            np.testing.assert_allclose(found, patches(wavelength)[bands, 6 * row + column], rtol=0.06, atol=2e-3)
    assert patch_centre(1)[0] - patch_centre(0)[0] == PATCH_PITCH_MM


def test_a_cold_lamp_settles_as_an_exponential_and_a_warm_one_only_drifts() -> None:
    lamp = LampOptions(warm_up=0.2, warm_up_s=100, drift_per_min=1e-3, on_before_s=5000)
    setup = replace(SETUP, lamp=lamp)
    times = np.array([0.0, 100.0, 400.0])
    cold = [frame(COLD_LAMP, setup, time_s=t)[300].mean() for t in times]
    expected = 1 + 0.2 * np.exp(-times / 100) + 1e-3 * times / 60
    np.testing.assert_allclose(np.array(cold) / cold[0], expected / expected[0], rtol=1e-3)
    assert settled(setup, 0) == pytest.approx(1 + 1e-3 * 5000 / 60)
    steady = [frame("white", time_s=t)[300].mean() for t in times]
    assert np.ptp(steady) == 0


def test_flicker_is_of_the_whole_frame_and_of_its_number() -> None:
    setup = replace(SETUP, lamp=LampOptions(flicker=0.02))
    levels = np.array([frame("white", setup, index=index)[300:900].mean() for index in range(120)])
    assert np.std(levels) / levels.mean() == pytest.approx(0.02, rel=0.25)
    assert frame("white", setup, index=7)[300:900].mean() == levels[7]


def test_options_of_the_target_are_checked() -> None:
    with pytest.raises(ValueError, match="grid_mm"):
        TargetOptions(grid_mm=0)

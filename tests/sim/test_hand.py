"""The hand: spectra of skin, vessels, geometry, and a picture that a person would recognise (by numbers)."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi_sim import skin
from scanhsi_sim.optics import wavelength_nm
from scanhsi_sim.scenes import Geometry, load_scene
from scanhsi_sim.scenes import hand as hand_module
from scanhsi_sim.scenes.shapes import PITCH_MM, X_MM, Y_MM

NM = np.arange(375.0, 948.0, 0.5)


def at(values: NDArray[np.floating], nm: float) -> float:
    return float(np.interp(nm, NM, values))


def test_oxyhaemoglobin_has_its_w() -> None:
    absorption = skin.blood_absorption(NM, 1.0)
    assert at(absorption, 542) > at(absorption, 560) < at(absorption, 576)
    peaks = [nm for nm, before, here, after in zip(NM[1:], absorption, absorption[1:], absorption[2:], strict=False)
             if 530 < nm < 590 and before < here > after]  # fmt: skip
    assert peaks == pytest.approx([542, 576.5], abs=2)
    deoxy = skin.blood_absorption(NM, 0.0)
    assert at(deoxy, 556) > at(deoxy, 542)
    assert at(deoxy, 556) > at(deoxy, 576)


def test_the_w_shows_in_skin() -> None:
    reflectance = skin.skin(NM, blood=0.03, saturation=0.95)
    assert at(reflectance, 542) < at(reflectance, 560) > at(reflectance, 576)


def test_isosbestic_point_near_797_nm() -> None:
    difference = skin.blood_absorption(NM, 1.0) - skin.blood_absorption(NM, 0.0)
    crossing = NM[1:][(NM[1:] > 760) & (np.sign(difference[1:]) != np.sign(difference[:-1]))]
    assert crossing == pytest.approx([797], abs=1.5)


def test_whole_blood_absorbs_as_the_literature_says() -> None:
    """150 g/l: about 0.44 per mm at 800 nm, some 28 per mm at 542 nm."""
    assert at(skin.blood_absorption(NM, 1.0), 800) == pytest.approx(0.437, rel=0.01)
    assert at(skin.blood_absorption(NM, 1.0), 542) == pytest.approx(28.5, rel=0.02)


def test_skin_reflectance_is_plausible() -> None:
    pale = skin.skin(NM)
    assert 0.05 < at(pale, 420) < 0.25
    assert 0.4 < at(pale, 650) < 0.75
    assert at(pale, 800) > at(pale, 560) > at(pale, 420)
    assert at(skin.skin(NM, blood=0.06), 560) < at(pale, 560)
    assert at(skin.skin(NM, melanin=0.3), 450) < 0.8 * at(pale, 450)


def test_diffusion_agrees_with_the_reference_values() -> None:
    """Rd .6149 for mu_a .01, mu_s' 1 per mm, n 1.4 (paper reference, section 8)."""
    assert skin.diffuse_reflectance(np.array([0.01]), np.array([1.0]))[0] == pytest.approx(0.6149, abs=5e-4)


def test_veins_are_dark_in_the_near_infrared_and_not_in_the_blue() -> None:
    pale = skin.skin(NM)
    contrast = 1 - skin.over_vein(NM, pale) / pale
    assert at(contrast, 803) > 0.15
    assert at(contrast, 760) > 0.15
    assert at(contrast, 440) < 0.02
    # Less saturated blood absorbs more at its 760 nm band, and less above the isosbestic point.
    venous, arterial = (skin.over_vein(NM, pale, saturation=s) for s in (0.6, 0.98))
    assert at(venous, 760) < at(arterial, 760)
    assert at(venous, 850) > at(arterial, 850)


def test_wavelengths_of_the_sensor() -> None:
    """Erratum 13: 371 to 950 nm over 218 channels of 5 rows."""
    wavelength = wavelength_nm(1091)
    assert wavelength[[0, 1085, 1090]] == pytest.approx([370.79, 947.64, 950.28], abs=0.01)


def test_lines_look_where_the_mirror_points() -> None:
    geometry = Geometry(distance_mm=348.73, normal_step=100)
    assert geometry.y_mm(100) == 0
    assert geometry.y_mm(99) - geometry.y_mm(100) == pytest.approx(0.2282, abs=1e-4)  # paper, eq 12
    assert geometry.y_mm(100 + 600) == pytest.approx(-144.45, abs=0.01)  # gamma = pi/8
    edge = geometry.x_mm(100, np.array([0, 2047], np.float32))
    assert edge == pytest.approx([-1023.5 * 0.155, 1023.5 * 0.155])
    assert geometry.x_mm(700, np.array([2047], np.float32))[0] == pytest.approx(edge[1] / np.cos(np.pi / 8), rel=1e-6)


@cache
def maps() -> NDArray[np.float32]:
    return hand_module.draw(0).astype(np.float32)


def place(x: float, y: float) -> tuple[int, int]:
    return round((Y_MM[1] - y) / PITCH_MM), round((x - X_MM[0]) / PITCH_MM)


def flesh() -> NDArray[np.float32]:
    total = maps()
    return (
        total[hand_module.PALE]
        + total[hand_module.RED]
        + total[hand_module.TANNED]
        + total[hand_module.VEIN]
        + total[hand_module.NAIL]
    )


def test_maps_are_shares() -> None:
    assert maps().min() > -1e-3
    assert maps()[: hand_module.GLOSS].sum(0).max() < 2.1
    assert flesh().max() <= 1.01


def test_a_hand_has_five_fingers() -> None:
    skin_mask = flesh() > 0.15

    def runs(y: float) -> int:
        row = skin_mask[place(0, y)[0]].astype(int)
        return int((np.diff(row, prepend=0) == 1).sum())

    assert runs(107) == 1  # the middle finger is the longest
    assert runs(50) == 4
    assert runs(5) == 2  # the palm and the thumb
    assert runs(-60) == 1
    assert runs(-140) == 1  # the forearm goes on
    assert skin_mask[place(-70, 10)]
    assert not skin_mask[place(-50, 10)]


def test_vessels_run_over_its_back() -> None:
    row = maps()[hand_module.VEIN, place(0, -40)[0]]
    assert (np.diff((row > 0.25).astype(int)) == 1).sum() >= 3


def test_the_white_strip_is_in_every_line_of_the_roi() -> None:
    geometry = Geometry()
    for step in (-600, 0, 600):
        line = hand_module.HandMaps.line(_Lines(geometry), step, 424, 1200)
        assert line[hand_module.WHITE].max() > 0.95
        assert line.shape == (8, 1200)


class _Lines(hand_module.HandMaps):
    """Without drawing the maps again."""

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._maps = maps().astype(np.float16)


@cache
def hand_scene() -> hand_module.SpectralScene:
    scene = load_scene("hand")
    assert isinstance(scene, hand_module.SpectralScene)
    return scene


def shoot(
    step: int, end: int | None = None, *, exposure_s: float = 0.05, bits: int = 12, index: int = 0
) -> NDArray[np.floating]:
    frame = hand_scene().render(
        step,
        step if end is None else end,
        exposure_s=exposure_s,
        gain_db=0,
        shape=(1088, 1200),
        offset=(0, 424),
        bits=bits,
        index=index,
    )
    return frame.astype(np.float32)


def test_exposure_is_right_at_50_ms() -> None:
    frame = shoot(60)
    flat = np.sort(frame[500:700].mean(0))
    assert 0.5 * 4095 < flat[-20] < 0.8 * 4095  # the white strip
    hand = frame[560:640, 400:560].mean()
    assert 0.15 * 4095 < hand < 0.5 * 4095
    assert (frame < 4095).mean() > 0.999
    at_20 = shoot(60, exposure_s=0.02)[560:640, 400:560].mean()
    offset = 100 / 13_500 * 4095
    assert (hand - offset) / (at_20 - offset) == pytest.approx(2.5, rel=0.02)
    bright = shoot(60, exposure_s=0.1)[560:640]
    assert (bright[:, 400:560] < 4095).mean() > 0.999
    assert np.sort(bright.mean(0))[-20] > 4000


def test_vessels_show_at_803_nm() -> None:
    """Seen through the whole chain: darker than the skin beside them, against the same line in the blue."""
    geometry, wavelength = Geometry(), wavelength_nm(1088)
    step = round(-np.arctan(-40 / 350) * 19_200 / 4 / np.pi)
    share = _Lines(geometry).line(step, 424, 1200)[hand_module.VEIN]
    x = geometry.x_mm(step, np.arange(424, 1624, dtype=np.float32))
    back = (x > -25) & (x < 28)
    inside, beside = back & (share > 0.4), back & (share < 0.02)
    frame = np.mean([shoot(step, index=index) for index in range(4)], axis=0) - 100 / 13_500 * 4095

    def contrast(nm: float) -> float:
        band = int(np.argmin(abs(wavelength - nm)))
        spectrum = frame[band - 4 : band + 5].mean(0)
        return float(1 - spectrum[inside].mean() / spectrum[beside].mean())

    assert contrast(803) > 0.06
    assert contrast(760) > 0.06
    assert contrast(803) > contrast(450) + 0.04


def test_motion_blurs_a_line_to_its_mean() -> None:
    ends = [np.mean([shoot(step, index=i) for i in range(2)], 0) for step in (-260, -250)]
    blurred = shoot(-260, -250)
    assert abs(ends[0] - ends[1]).max() > 150
    low, high = np.minimum(*ends) - 300, np.maximum(*ends) + 300
    assert ((blurred > low) & (blurred < high)).mean() > 0.98


def test_frames_are_reproducible_and_noisy() -> None:
    np.testing.assert_array_equal(shoot(3, index=5), shoot(3, index=5))
    assert (shoot(3, index=5) != shoot(3, index=6)).mean() > 0.8
    assert shoot(3, bits=8).max() <= 255

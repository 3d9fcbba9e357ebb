"""White references, dark models as references, and saturation below full scale."""

from __future__ import annotations

import numpy as np
import pytest

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import fit_dark
from scanhsi.calibration.frames import FrameStack
from scanhsi.calibration.reference import ModelledDark, Reference
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.saturation import Histogram
from scanhsi.calibration.white import white_reference
from scanhsi.devices.errors import CalibrationError

TAKEN = Conditions(0.02, 0.0, "Mono12")
SHAPE = (4, 5)


def stack(level: float, *, saturated: int = 0, lines: int = 20, conditions: Conditions = TAKEN) -> FrameStack:
    mask = np.zeros(SHAPE, bool)
    mask.flat[:saturated] = True
    return FrameStack("white.zarr", np.full(SHAPE, level), np.full(SHAPE, 10.0), mask, 4095, lines, conditions)


def dark(level: float = 100.0) -> Reference:
    return Reference("dark.zarr", np.full(SHAPE, level, np.float32), 20, TAKEN)


def test_a_plateau_below_full_scale_is_found() -> None:
    rng = np.random.default_rng(1)
    seen = Histogram(65535)
    for _ in range(5):
        seen.add(np.minimum(rng.normal(50_000, 6_000, (100, 200)), 57_351).astype(np.uint16))
    assert seen.plateau() == 57_351


@pytest.mark.parametrize("level", [100.0, 3000.0])
def test_unsaturated_frames_have_no_plateau(level: float) -> None:
    seen = Histogram(4095)
    seen.add(np.random.default_rng(2).normal(level, 12, (300, 300)).astype(np.uint16))
    assert seen.plateau() is None


def test_full_scale_is_no_plateau_below_it() -> None:
    seen = Histogram(4095)
    seen.add(np.full((50, 50), 4095, np.uint16))
    assert seen.plateau() is None


def test_saturated_pixels_of_the_tile_have_no_value() -> None:
    made = white_reference(stack(3000.0, saturated=2), dark(), Provenance(), tile=0.99)
    assert np.isnan(made.mean).sum() == 2
    white, below = made.references("white.nc")
    assert np.isnan(white.mean).sum() == 2
    np.testing.assert_array_equal(below.mean, 100.0)
    assert made.exposure_s == 0.02


@pytest.mark.parametrize(
    ("frames", "tile", "why"),
    [
        (stack(100.0), 0.99, "no light"),
        (stack(3000.0, lines=1), 0.99, "single line"),
        (stack(3000.0, saturated=15), 0.99, "75 % .* is saturated"),
        (stack(3000.0, conditions=Conditions(0.04, 0.0, "Mono12")), 0.99, "exposure 20 ms instead of 40 ms"),
        (stack(3000.0), 2.0, "reflectance of 2"),
    ],
)
def test_white_references_that_are_none_are_refused(frames: FrameStack, tile: float, why: str) -> None:
    with pytest.raises(CalibrationError, match=why):
        white_reference(frames, dark(), Provenance(), tile=tile)


def test_a_dark_model_stands_in_for_a_reference_where_it_was_measured() -> None:
    frames = [(t, np.full(SHAPE, 30.0 + 40.0 * t + shift)) for t in (0.01, 0.1, 1.0) for shift in (-0.5, 0.5)]
    model = ModelledDark("dark.nc", fit_dark(frames, Provenance(conditions=Conditions(None, 0.0, "Mono12"))))
    found = model.at(0.5)
    np.testing.assert_allclose(found.mean, 50.0, atol=0.01)
    assert found.conditions.exposure_s == 0.5
    with pytest.raises(CalibrationError, match="measured up to 1 s"):
        model.at(2.0)
    with pytest.raises(CalibrationError, match="does not say which one it had"):
        model.at(None)

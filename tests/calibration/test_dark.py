import numpy as np
import pytest

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkFit, DarkModel, _stands_out, fit_dark
from scanhsi.calibration.result import Provenance, load, save
from scanhsi.devices.errors import CalibrationError

SHAPE = (60, 80)
EXPOSURES = (0.01, 0.05, 0.1, 0.2, 0.5, 1.0, 1.5, 2.0)
TAKEN = Provenance(
    ("darks.zarr",), Conditions(None, 3.0, "Mono12", {"bands": 60}), True, taken="2026-11-22T10:00:00+00:00"
)


def dark_frames(rng, *, frames: int = 20, gain: float = 0.3, hot: float = 0.0, bent: float = 0.0):
    """Truth of rate and offset in counts, and frames of 12 bits; counts = gain x electrons."""
    rate = 125 * rng.lognormal(0, 0.1, SHAPE)
    offset = rng.normal(100, 5, SHAPE)
    flaws = rng.permutation(rate.size)
    hot_pixels = np.unravel_index(flaws[:24], SHAPE)
    bent_pixels = np.unravel_index(flaws[24:48], SHAPE)
    rate[hot_pixels] += hot
    taken = []
    for exposure in EXPOSURES:
        electrons = rate * exposure
        electrons[bent_pixels] += bent * exposure**2
        for _ in range(frames):
            noisy = rng.poisson(electrons) + offset + rng.normal(0, 13, SHAPE)
            taken.append((exposure, np.clip(np.rint(gain * noisy), 0, 4095).astype(np.uint16)))
    return gain * rate, gain * offset, hot_pixels, bent_pixels, taken


def test_rate_and_offset_within_three_sigma_for_997_of_1000_pixels():
    rng = np.random.default_rng(5)
    rate, offset, _, _, frames = dark_frames(rng)
    model = fit_dark(frames, TAKEN)
    for fitted, sigma, truth in ((model.rate, model.rate_sigma, rate), (model.offset, model.offset_sigma, offset)):
        pulls = (fitted - truth) / sigma
        assert np.mean(np.abs(pulls) < 3) >= 0.995  # 99.7 % of 4800 pixels, within its own error
        assert np.std(pulls) == pytest.approx(1, abs=0.06)
    predicted = (model.at(0.2) - (rate * 0.2 + offset)) / model.sigma_at(0.2)
    assert np.std(predicted) == pytest.approx(1, abs=0.06)


def test_all_hot_pixels_are_found_and_hardly_any_other():
    rng = np.random.default_rng(6)
    _, _, hot, _, frames = dark_frames(rng, hot=6 * 13.0 + 200)
    model = fit_dark(frames, TAKEN)
    found = model.hot.copy()
    assert found[hot].all()
    found[hot] = False
    assert not found.any()


@pytest.mark.parametrize("spread", [0.0, 0.1, 0.4, 0.8])
def test_hot_pixels_are_told_from_the_tail_of_any_distribution_of_dark_currents(spread: float):
    """Less than one in 10^4 is taken for hot, and all are that lie 7 sigma out, in the logarithm where that is what scatters."""
    rng = np.random.default_rng(11)
    rate = 40 * rng.lognormal(0, spread, 200_000) + rng.normal(0, 3, 200_000)
    hot = rng.choice(rate.size, 400, replace=False)
    rate[hot] = 40 * np.exp(7.5 * spread) + rng.uniform(7.5 * 3, 4000, 400)
    found = _stands_out(rate, 6.0)
    assert found[hot].all()
    found[hot] = False
    assert found.mean() < 1e-4


def test_a_pixel_full_at_every_exposure_is_hot_although_its_counts_do_not_grow():
    _, _, _, _, frames = dark_frames(np.random.default_rng(12), frames=3)
    for _, frame in frames:
        frame[4, 5] = 3800  # a plateau below full scale
    model = fit_dark(frames, TAKEN, saturation=4095)
    assert model.hot[4, 5]
    assert model.hot.sum() == 1


def test_pixels_that_are_no_line_are_flagged():
    rng = np.random.default_rng(7)
    _, _, _, bent, frames = dark_frames(rng, bent=150.0)
    model = fit_dark(frames, TAKEN)
    flagged = model.nonlinear.copy()
    assert flagged[bent].all()
    flagged[bent] = False
    assert flagged.mean() < 1e-3


def test_a_pixel_that_saturates_is_hot():
    frames = [(exposure, np.full(SHAPE, 50, np.uint16)) for exposure in (0.1, 0.2) for _ in range(3)]
    frames[-1][1][4, 5] = 4095
    assert np.argwhere(fit_dark(frames, TAKEN, saturation=4095).hot).tolist() == [[4, 5]]


def test_memory_does_not_grow_with_the_frames():
    fit = DarkFit()
    frame = np.random.default_rng(1).integers(90, 110, SHAPE).astype(np.uint16)
    for number in range(100):
        fit.add(0.1 + 0.1 * (number % 2), frame + number % 3)
    assert len(fit._groups) == 2
    model = fit.fit()
    assert model.frames == 100


@pytest.mark.parametrize(
    ("frames", "why"),
    [
        ([], "at 0 exposures"),
        ([(0.1, np.zeros(SHAPE))] * 4, "at 1 exposure are no line"),
        ([(0.1, np.zeros(SHAPE)), (0.2, np.zeros(SHAPE)), (0.2, np.zeros(SHAPE))], r"shows no noise.*0\.1 s"),
        ([(0.1, np.zeros(SHAPE)), (0.1, np.zeros((3, 4)))], "do not go together"),
        ([(0.1, np.full(SHAPE, np.nan))], "no numbers"),
        ([(0.0, np.zeros(SHAPE))], "exposure of 0 s"),
        ([(0.1, np.zeros(0))], "two axes"),
    ],
)
def test_what_cannot_be_fitted_is_refused(frames: list, why: str):
    with pytest.raises(CalibrationError, match=why):
        fit_dark(frames)


def test_the_model_says_nothing_beyond_its_exposures():
    rng = np.random.default_rng(8)
    model = fit_dark(dark_frames(rng, frames=2)[-1])
    with pytest.raises(CalibrationError, match=r"up to 2 s"):
        model.at(3.0)


def test_a_result_is_the_same_after_a_file(tmp_path):
    model = fit_dark(dark_frames(np.random.default_rng(9), frames=3)[-1], TAKEN)
    save(model, tmp_path / "dark.nc")
    again = load(DarkModel, tmp_path / "dark.nc")
    np.testing.assert_array_equal(again.rate, model.rate)
    np.testing.assert_array_equal(again.hot, model.hot)
    assert again.hot.dtype == bool
    assert (again.longest_s, again.frames) == (2.0, 24)
    assert again.provenance == model.provenance
    assert list(tmp_path.iterdir()) == [tmp_path / "dark.nc"]


def test_what_is_no_such_file_is_refused(tmp_path):
    (tmp_path / "text.nc").write_text("no")
    with pytest.raises(CalibrationError, match="there is no"):
        load(DarkModel, tmp_path / "missing.nc")
    with pytest.raises(CalibrationError, match="cannot read"):
        load(DarkModel, tmp_path / "text.nc")

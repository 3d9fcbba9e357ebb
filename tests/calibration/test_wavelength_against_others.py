"""The same peaks identified by specreduce and rascal, where they are installed: `pip install specreduce rascal`.

They are not among the dependencies for tests: rascal is old, specreduce brings astropy. What they said of these very peaks (of
`lamp`, noise of 200 averaged lines, seed 1) is also written down below, so that the comparison is made either way.
"""

import numpy as np
import pytest

from scanhsi.calibration.assign import assign_lines
from scanhsi.calibration.lines import hgar
from scanhsi.calibration.peaks import find_peaks
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.wavelength import calibrate_with_lamp
from support.lamps import BANDS, TRUTH_NM, lamp, noisy

LINES = hgar().merged(1.8).calibrating().within(380, 946)


@pytest.fixture(scope="module")
def spectrum() -> np.ndarray:
    return noisy(lamp(), 1, 200)


def rms(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))


def test_what_rascal_found_once(spectrum):
    """rascal 0.3.11, Hough transform and RANSAC, degree 2: within a nanometre, it does not fit blends."""
    theirs = np.polynomial.polynomial.polyval(BANDS, [3.72924422e02, 5.30139266e-01, -2.04641877e-07])
    ours = calibrate_with_lamp(spectrum, Provenance()).nm()
    assert rms(ours, theirs) < 0.8
    assert rms(ours, TRUTH_NM) < 0.01 < rms(theirs, TRUTH_NM)


def test_specreduce_finds_the_same_dispersion(spectrum):
    """specreduce 1.9.0: 0.10 nm rms from these peaks, blends among them taken for single lines; ours from the same peaks alike."""
    wavecal = pytest.importorskip("specreduce.wavecal1d")
    import astropy.units as u

    places = find_peaks(spectrum).centre_px
    calibration = wavecal.WavelengthCalibration1D(
        obs_lines=places, line_lists=[LINES.wavelength_nm], ref_pixel=544.0, unit=u.nm, pix_bounds=(0, 1088)
    )
    found = calibration.fit_dispersion(
        wavelength_bounds=(640.0, 680.0),
        dispersion_bounds=(0.45, 0.65),
        higher_order_limits=[1e-4],
        degree=2,
        refined_fit_degree=2,
        popsize=10,
        max_distance=10.0,
    )
    theirs = np.asarray(found.pix_to_wav(BANDS))
    assert rms(assign_lines(places, LINES).dispersion.nm(BANDS), theirs) < 0.2
    assert rms(calibrate_with_lamp(spectrum, Provenance()).nm(), theirs) < 0.2

"""Which peak is which line, by specreduce and rascal: run it in an environment of its own, on the peaks that `wavelength` uses.

``python -m venv .venv-lines && .venv-lines/bin/pip install specreduce==1.9.0 rascal==0.3.11``, then
``.venv-lines/bin/python tests/benchmarks/accuracy/identify.py LINES [CASES]``; LINES is the file of wavelengths that
``python tests/benchmarks/accuracy --lines LINES`` writes. Both are told what our own is told: 0.45 to 0.65 nm a band, from 340 to
430 nm. An answer counts as right when the bands are off by less than a nanometre rms.
"""

import logging
import sys
import time
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
from peaks import BANDS, TRUTH_NM, peaks_of
from rascal.atlas import Atlas
from rascal.calibrator import Calibrator
from specreduce.wavecal1d import WavelengthCalibration1D

SLOPE, FIRST = (0.45, 0.65), (340.0, 430.0)


def specreduce(peaks, lines):
    calibration = WavelengthCalibration1D(
        obs_lines=np.sort(peaks), line_lists=[lines], ref_pixel=544.0, unit=u.nm, pix_bounds=(0, 1088)
    )
    found = calibration.fit_dispersion(
        wavelength_bounds=(FIRST[0] + 544 * SLOPE[0], FIRST[1] + 544 * SLOPE[1]),
        dispersion_bounds=SLOPE,
        higher_order_limits=[1e-4],
        degree=2,
        refined_fit_degree=2,
        popsize=10,
        max_distance=10.0,
    )
    return np.asarray(found.pix_to_wav(BANDS))


def rascal(peaks, lines):
    calibrator = Calibrator(np.sort(peaks))
    calibrator.set_calibrator_properties(num_pix=len(BANDS), pixel_list=BANDS, log_level="error")
    calibrator.set_hough_properties(
        num_slopes=2000,
        xbins=200,
        ybins=200,
        min_wavelength=370.0,
        max_wavelength=950.0,
        range_tolerance=50.0,
        linearity_tolerance=5.0,
    )
    atlas = Atlas(range_tolerance=50.0)
    atlas.add_user_atlas(
        elements=["HgAr"] * len(lines), wavelengths=lines.tolist(), vacuum=True
    )  # as they are, no conversion
    calibrator.set_atlas(atlas, candidate_tolerance=2.0)
    calibrator.set_ransac_properties(
        sample_size=5, top_n_candidate=5, linear=True, filter_close=True, ransac_tolerance=1.0
    )
    calibrator.do_hough_transform()
    found = calibrator.fit(max_tries=500, fit_deg=2, fit_tolerance=2.0, progress=False)
    return np.polynomial.polynomial.polyval(BANDS, np.asarray(found[0], float))


def main(lines: np.ndarray, cases: int) -> None:
    print("| | right, none missing | right, 30 % missing and 30 % spurious | median rms where right | s a case |")
    print("| --- | --- | --- | --- | --- |")
    for identify in (specreduce, rascal):
        cells, errors, began = [], [], time.perf_counter()
        for share in (0.0, 0.3):
            right = 0
            for seed in range(cases):
                np.random.seed(seed)
                try:
                    off = identify(peaks_of(lines, seed, share, share)[0], lines) - TRUTH_NM
                except Exception as error:
                    print(f"{identify.__name__}: {error!r}", file=sys.stderr)
                    continue
                if np.sqrt(np.mean(off**2)) < 1.0:
                    right += 1
                    errors.append(np.sqrt(np.mean(off**2)))
            cells.append(f"{right} of {cases}")
        seconds = (time.perf_counter() - began) / (2 * cases)
        median = f"{np.median(errors):.2f} nm" if errors else ""
        print(f"| {identify.__name__} | {' | '.join(cells)} | {median} | {seconds:.2f} |", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
    main(np.loadtxt(Path(sys.argv[1])), int(sys.argv[2]) if len(sys.argv) > 2 else 20)

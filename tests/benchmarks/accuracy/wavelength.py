"""Wavelengths, line spread, smile and keystone; which peak is which line."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from peaks import BANDS, TRUTH_NM, peaks_of
from rows import Row, acquire, region, rms

from scanhsi.calibration.assign import assign_lines
from scanhsi.calibration.dispersion import fit_dispersion_robustly
from scanhsi.calibration.keystone import fit_keystone
from scanhsi.calibration.lines import LineList, hgar, load_lines
from scanhsi.calibration.reference import average
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.smile import calibrate_spectrograph
from scanhsi.calibration.tile import calibrate_with_tile
from scanhsi.devices.errors import CalibrationError

SLIT = 360
SLIT_ONLY = {"camera.samples": SLIT, "roi.samples": SLIT, "roi.sample_offset": 0}
WCS = [96, 201, 251, 284, 528, 712, 795.5, 962, 988]
WCS_NM = [423.217, 478.932, 502.810, 537.373, 650.216, 748.964, 797.834, 881.225, 911.206]


def lamp(seeds: int, fwhm_nm: float, blur: float | None = None) -> list[Row]:
    errors, largest, widths, pulls, lines = [], [], [], [], []
    for seed in range(1, seeds + 1):
        settings = {
            "roi.samples": 100,
            "roi.sample_offset": 974,
            "camera.seed": seed,
            "camera.optics.lsf_fwhm_nm": fwhm_nm,
            **({} if blur is None else {"camera.optics.lsf_blur": blur}),
        }
        found, true, _ = acquire(settings, lambda hsi: hsi.calibrate.wavelength(frames=20))
        error = found.nm() - true.wavelength_nm
        errors.append(rms(error))
        largest.append(float(np.abs(error).max()))
        at = np.array([450.0, 600.0, 850.0])
        widths.append(found.fwhm_nm(at) / np.interp(at, true.wavelength_nm, true.lsf_fwhm_nm) - 1)
        pulls.append((error / found.sigma_nm())[[50, 500, 1000]])
        lines.append(len(found.line_nm))
    width = float(np.abs(widths).max())
    kind = "Gaussian" if blur is None else "flat-topped"
    return [
        Row(f"**wavelengths**, HgAr, {kind} lines of {fwhm_nm:g} nm, {seeds} instruments, 20 frames", "", ""),
        Row("quadratic, rms, worst seed", "0.05 nm", f"{max(errors):.4f} nm", max(errors) < 0.05),
        Row(
            "largest error of a band",
            "0.026 nm (12 single lines)",
            f"{max(largest):.4f} nm",
            max(largest) < 0.05,
        ),
        Row("line spread, largest error", "2 %", f"{100 * width:.2f} %", width < 0.02),
        Row("error over the one given, rms", "1 or less", f"{rms(pulls):.2f}", rms(pulls) < 1.6),
        Row("lines and groups fitted", "8 or more", f"{min(lines)} to {max(lines)}", min(lines) >= 8),
    ]


def seen(scene: str, exposure_s: float, lines: int):
    """Mean frame of a scene over the whole slit, dark-corrected, hot pixels filled; and the truth."""

    async def both(hsi):
        with tempfile.TemporaryDirectory() as folder:
            frames = []
            for target in ("dark", scene):
                await hsi.camera.show(target)
                plan = hsi.default_plan(lines=lines, step=0, start=0, exposure_s=exposure_s)
                await hsi.scan(plan, Path(folder) / f"{target}.zarr")
                frames.append(average(Path(folder) / f"{target}.zarr").mean.astype(float))
        return frames[1] - frames[0]

    frame, true, config = acquire(SLIT_ONLY, both)
    frame[true.hot[region(config)]] = np.nan
    for band, sample in np.argwhere(np.isnan(frame)):
        frame[band, sample] = np.nanmean(frame[band, max(0, sample - 3) : sample + 4])
    return frame, true


def slit() -> list[Row]:
    frame, true = seen("hgar", 0.1, 12)
    wavelength, smile = calibrate_spectrograph(frame, Provenance())
    error = rms(wavelength.nm() - true.wavelength_nm)
    bent = np.abs(smile.shift(544, np.arange(SLIT)) - (true.smile_bands - true.smile_bands[SLIT // 2])).max()
    frame, true = seen("slanted-lines", 0.03, 3)
    stretched = rms(fit_keystone(frame, Provenance()).shift() - (true.keystone_samples - true.keystone_samples[544]))
    return [
        Row("**whole slit**, 360 samples, smile of 0.8 bands, keystone of 0.6 samples", "", ""),
        Row("quadratic, HgAr, rms", "0.05 nm", f"{error:.4f} nm", error < 0.05),
        Row("smile, largest error", "sub-pixel", f"{bent:.4f} bands", bent < 0.03),
        Row("keystone, rms error", "sub-pixel", f"{stretched:.4f} samples", stretched < 0.03),
    ]


def tile() -> Row:
    import scanhsi_sim

    table = Path(scanhsi_sim.__file__).parent / "data/wavelength_tile.csv"
    (here, true), (white, _) = seen("wavelength-tile", 0.04, 12), seen("white", 0.04, 12)
    used, middle = slice(30, 1075), slice(150, 210)
    reflectance = here[used, middle].mean(axis=1) / white[used, middle].mean(axis=1)
    found = calibrate_with_tile(reflectance, load_lines(table), Provenance(), fwhm_bands=16)
    error = rms(found.nm() - true.wavelength_nm[used])
    return Row(
        f"absorption tile, {len(found.line_nm)} minima: quadratic, rms",
        "recover the polynomial",
        f"{error:.3f} nm",
        error < 0.3,
    )


def lines_to_find() -> LineList:
    return hgar().merged(1.8).calibrating().within(380, 946)


def assignment(seeds: int, missing: float, spurious: float, *, asked: bool = True) -> list[Row]:
    """Peaks of the lamp with some missing and some that are no lines: right is every real peak on its own line."""
    lines = lines_to_find()
    right = refused = wrong = 0
    errors: list[float] = []
    for seed in range(seeds):
        peaks, line = peaks_of(lines.wavelength_nm, seed, missing, spurious)
        try:
            found = assign_lines(peaks, lines)
        except CalibrationError:
            refused += 1
            continue
        off = found.dispersion.nm(BANDS) - TRUTH_NM
        real = line[found.peak] >= 0
        good = bool((line[found.peak][real] == found.line[real]).all()) and float(np.abs(off).max()) < 1.0
        right, wrong = right + good, wrong + (not good)
        errors += [rms(off)] if good else []
    return [
        Row(f"**lines assigned**, {100 * missing:.0f} % missing, {100 * spurious:.0f} % spurious", "", ""),
        Row("right", "all" if asked else "", f"{right} of {seeds}", right >= 0.995 * seeds or not asked),
        Row(
            "wrong, not refused",
            "0" if asked else "",
            f"{wrong} of {seeds}, {refused} refused",
            wrong == 0 or not asked,
        ),
        Row("rms over the bands where right, median", "", f"{np.median(errors):.2f} nm"),
    ]


def wrong_pairs() -> Row:
    curve, good = fit_dispersion_robustly(WCS, WCS_NM, degree=1)
    left = np.flatnonzero(~good).tolist()
    places = ", ".join(f"{WCS[index]:g}" for index in left)
    reached = f"{places} rejected; {curve.coefficients[0]:.2f} + {curve.coefficients[1]:.5f} px"
    return Row("nine public tile pairs", "284 and 988 rejected; 371.15 + 0.53169 px", reached, left == [3, 8])


def rows(seeds: int) -> list[Row]:
    few = max(2, seeds // 4)
    found = [*lamp(seeds, 2.9), *lamp(few, 2.88, 0.147), *lamp(few, 2.5), *lamp(few, 3.5), *slit(), tile()]
    for share, cases in ((0.0, 5), (0.3, 50)):
        found += assignment(cases * seeds, share, share)
    return [*found, *assignment(10 * seeds, 0.4, 0.4, asked=False), wrong_pairs()]

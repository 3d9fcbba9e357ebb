"""Wavelengths from a tile with absorption bands, such as a doped Spectralon with a certificate of its minima (figure 9).

The continuum (the convex hull above the reflectance) is divided out, minima are found as peaks of what is missing from it, and
their places by parabolas. Which minimum is which is found as for a lamp; pairs that lie off are left out.

A tile's bands are five to twenty times as wide as a lamp's lines: expect some tenths of a nanometre, and take a lamp for better.
"""

from __future__ import annotations

import math
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scanhsi.calibration.assign import DispersionRange, assign_lines
from scanhsi.calibration.dispersion import fit_dispersion, fit_dispersion_robustly
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.peaks import FWHM_PER_SIGMA, find_peaks, noise_of
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_SHALLOWEST: Final = 0.005  # depth of a minimum that counts, of the continuum
_CORE: Final = 0.35  # of its width to either side: where a minimum is a parabola


def continuum_removed(reflectance: NDArray[Any]) -> Floats:
    """Reflectance over its continuum, the upper convex hull over the bands: 1 where nothing is absorbed.

    Raises:
        CalibrationError: Not a row of positive numbers.
    """
    values = np.asarray(reflectance, np.float64)
    if values.ndim != 1 or len(values) < 3 or not np.isfinite(values).all():
        raise CalibrationError(
            "the spectrum of the tile has gaps, or is none.", hint="leave dark and saturated bands out"
        )
    hull = [0]
    for band in range(1, len(values)):
        while len(hull) > 1 and _below(values, hull[-2], hull[-1], band):
            hull.pop()
        hull.append(band)
    above = np.interp(np.arange(len(values)), hull, values[hull])
    if not (above > 0).all():
        raise CalibrationError("the tile reflects nothing in some bands.", hint="leave bands without light out")
    return values / above


def _below(values: Floats, first: int, middle: int, last: int) -> bool:
    """Whether the middle lies on or below the line from the first to the last."""
    rise = (values[last] - values[first]) * (middle - first)
    return bool((values[middle] - values[first]) * (last - first) <= rise)


def find_minima(reflectance: NDArray[Any], *, fwhm_bands: float = 25.0) -> tuple[Floats, Floats]:
    """Absorption minima of a tile.

    Args:
        reflectance: (band,).
        fwhm_bands: Roughly the width of the narrow ones, in bands.

    Returns:
        Where they lie, in bands, with standard errors, (minimum,) each.

    Raises:
        CalibrationError: No spectrum, or none of them.
    """
    missing = 1 - continuum_removed(reflectance)
    smooth = cast("Floats", ndimage.gaussian_filter1d(missing, 0.25 * fwhm_bands / FWHM_PER_SIGMA))
    peaks = find_peaks(smooth, fwhm_px=fwhm_bands)
    reach = max(2, round(_CORE * fwhm_bands))
    noise = noise_of(missing)
    found: list[tuple[float, float]] = []
    for centre, height in zip(peaks.centre_px.tolist(), peaks.height.tolist(), strict=True):
        low, high = max(0, round(centre) - reach), min(len(missing), round(centre) + reach + 1)
        if height < max(_SHALLOWEST, 3 * noise):
            continue
        one = _top(missing[low:high], low, noise)
        if one is not None:
            found.append(one)
    if not found:
        raise CalibrationError("the tile shows no absorption.", hint="is it the standard, and divided by a white tile?")
    places, sigma = np.array(sorted(found)).T
    return places, sigma


def _top(part: Floats, first: int, noise: float) -> tuple[float, float] | None:
    """Top of a parabola through some values, with its error; None where it has none, or not among them."""
    place: Floats = np.arange(len(part), dtype=np.float64) - (len(part) - 1) / 2
    design = np.stack((place**2, place, np.ones_like(place)), axis=1)
    bend, slope, _ = cast("Floats", np.linalg.lstsq(design, part, rcond=None)[0]).tolist()
    if bend >= 0 or abs(slope / (2 * bend)) > len(part) / 2:
        return None
    top = -slope / (2 * bend)
    gradient = np.array([slope / (2 * bend**2), -1 / (2 * bend), 0.0])
    variance = float(gradient @ np.linalg.inv(design.T @ design) @ gradient) * noise**2
    return first + (len(part) - 1) / 2 + top, math.sqrt(variance)


def calibrate_with_tile(
    reflectance: NDArray[Any],
    certificate: LineList,
    provenance: Provenance,
    *,
    prior: DispersionRange | None = None,
    degree: int = 2,
    fwhm_bands: float = 25.0,
    tolerance_nm: float = 2.5,
    first_band: int = 0,
    bands: int | None = None,
) -> Wavelength:
    """Calibrate with the reflectance of a tile whose minima are known.

    Args:
        reflectance: (band,) mean of the tile over a white tile.
        certificate: The minima, as `scanhsi.calibration.lines.load_lines` reads them; for the resolution of this instrument,
            if the certificate has several.
        provenance: Where it comes from.
        prior: What the dispersion may be.
        degree: Of the polynomial; 1 where there are fewer than eight minima.
        fwhm_bands: Roughly the width of the narrow minima, in bands.
        tolerance_nm: How far a minimum may lie from where the polynomial has it.
        first_band: Band of the sensor region that the spectrum begins with, where bands without light were left out.
        bands: Of the sensor region; those of the spectrum by default.

    Raises:
        CalibrationError: No spectrum, too few minima, or not those of the certificate.
    """
    places, errors = find_minima(reflectance, fwhm_bands=fwhm_bands)
    places = places + first_band
    found = assign_lines(places, certificate, prior=prior, degree=degree, tolerance_nm=tolerance_nm)
    band, known = places[found.peak], certificate.wavelength_nm[found.line]
    sigma = errors[found.peak]
    _, good = fit_dispersion_robustly(band, known, degree=degree)
    curve = fit_dispersion(band[good], known[good], degree=degree)
    nothing = np.full(int(good.sum()), np.nan)  # a tile's bands are wide by themselves
    return Wavelength(
        bands=first_band + len(reflectance) if bands is None else bands,
        coefficients=curve.coefficients,
        covariance=curve.covariance,
        line_nm=known[good],
        line_band=band[good],
        line_band_sigma=sigma[good],
        line_fwhm_nm=nothing,
        line_fwhm_sigma_nm=nothing,
        residual_nm=curve.residual_nm,
        p_value=curve.p_value,
        found=len(places),
        source=certificate.name,
        provenance=provenance,
    )

"""Peaks of a spectrum, to a fraction of a pixel: what a narrow line becomes on the sensor is a Gaussian on a slope.

Neighbours that overlap are fitted together. Errors are those of the fit, from the noise that the spectrum itself shows.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize, signal

from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

FWHM_PER_SIGMA: Final = math.sqrt(8 * math.log(2))
_LEAST_PIXELS: Final = 16
_NARROWEST: Final = 0.4
_REACH: Final = 1.5  # FWHM to either side that a fit takes in


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Peaks that stand out of a spectrum, by rising pixel.

    Attributes:
        centre_px, centre_sigma_px: Place, 0 is the middle of the first pixel, with its standard error, (peak,).
        fwhm_px, fwhm_sigma_px: Full width at half maximum, with its standard error, (peak,).
        height: Above the background, in the unit of the spectrum, (peak,).
    """

    centre_px: Floats
    centre_sigma_px: Floats
    fwhm_px: Floats
    fwhm_sigma_px: Floats
    height: Floats

    def __len__(self) -> int:
        return len(self.centre_px)


def noise_of(spectrum: Floats) -> float:
    """Standard deviation of the noise from pixel to pixel: robust, of second differences, which a smooth spectrum does not have."""
    second = np.diff(spectrum, 2)
    return float(1.4826 * np.median(np.abs(second))) / math.sqrt(6)


def find_peaks(spectrum: NDArray[Any], *, fwhm_px: float = 5.5, significance: float = 8.0) -> Peaks:
    """Find the peaks of an emission spectrum and fit them.

    Args:
        spectrum: (pixel,), background subtracted or not; for absorption, turn it upside down.
        fwhm_px: Roughly the width of a line: 5.5 pixels of the paper's instrument, 2.9 nm. A factor of two does not matter.
        significance: Heights that count, in standard deviations of the noise.

    Raises:
        CalibrationError: Fewer than 16 pixels, values that are no numbers, or nothing but noise.
    """
    values = np.asarray(spectrum, np.float64)
    if values.ndim != 1 or len(values) < _LEAST_PIXELS:
        raise CalibrationError(f"a spectrum has {_LEAST_PIXELS} pixels at least, not {values.shape}.")
    if not np.isfinite(values).all():
        where = np.flatnonzero(~np.isfinite(values))
        raise CalibrationError(
            f"{len(where)} pixels of the spectrum are no numbers, the first at {where[0]}: saturated, or missing.",
            hint="a shorter exposure",
        )
    # The largest of the two: a spectrum of one value with a few steps has no noise, and everything would stand out.
    noise = max(noise_of(values), 1e-6 * float(np.ptp(values)))
    smooth = cast("Floats", ndimage.gaussian_filter1d(values, 0.35 * fwhm_px / FWHM_PER_SIGMA))
    found, _ = cast(
        "tuple[NDArray[np.intp], Any]",
        signal.find_peaks(smooth, prominence=significance * noise, distance=max(1, round(fwhm_px / 2))),
    )
    if not len(found) or noise == 0:
        raise CalibrationError("no peak stands out of the noise.", hint="is the lamp on, and the exposure long enough?")
    groups = np.split(found, np.flatnonzero(np.diff(found) > 2 * fwhm_px) + 1)
    fitted = [row for group in groups for row in _fit_group(values, group.tolist(), fwhm_px, noise)]
    rows = np.array(fitted).reshape(-1, 5)
    narrow = _NARROWEST * fwhm_px  # a hot pixel
    kept = rows[(rows[:, 4] > significance * noise) & (rows[:, 1] < fwhm_px) & (rows[:, 2] > narrow)]
    if not len(kept):
        raise CalibrationError("no peak has the shape of a line.", hint="give its width, fwhm_px")
    kept = kept[np.argsort(kept[:, 0])]
    return Peaks(*kept.T)


def gaussian(pixel: Floats, centre: float, fwhm: float, height: float) -> Floats:
    """A line as a slit and an even blur make it."""
    return height * np.exp(-0.5 * ((pixel - centre) * FWHM_PER_SIGMA / fwhm) ** 2)


def _fit_group(values: Floats, places: list[int], fwhm_px: float, noise: float) -> list[tuple[float, ...]]:
    """Centre, its error, width, its error, height of each of some peaks that overlap; none where no fit is found."""
    reach = math.ceil(_REACH * fwhm_px)
    low, high = max(0, places[0] - reach), min(len(values), places[-1] + reach + 1)
    pixel: Floats = np.arange(low, high, dtype=np.float64)
    part = values[low:high]
    if len(part) < 3 * len(places) + 3:
        return []

    def model(pixel: Floats, level: float, slope: float, *peaks: float) -> Floats:
        total = level + slope * (pixel - places[0])
        for centre, fwhm, height in zip(peaks[::3], peaks[1::3], peaks[2::3], strict=True):
            total = total + gaussian(pixel, centre, fwhm, height)
        return total

    floor = float(part.min())
    start, least, most = [floor, 0.0], [-np.inf, -np.inf], [np.inf, np.inf]
    for place in places:
        start += [float(place), fwhm_px, max(float(values[place]) - floor, noise)]
        least += [place - fwhm_px, 0.3 * fwhm_px, 0.0]
        most += [place + fwhm_px, 3.0 * fwhm_px, np.inf]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optimize.OptimizeWarning)
        try:
            fit = cast("Any", optimize.curve_fit(model, pixel, part, start, bounds=(least, most), max_nfev=400))
        except RuntimeError:
            return []
    best, covariance = cast("tuple[Floats, Floats]", (fit[0], fit[1]))
    sigma = np.sqrt(np.diag(covariance))
    return [
        (best[at], sigma[at], best[at + 1], sigma[at + 1], best[at + 2])
        for at in range(2, len(best), 3)
        if np.isfinite(sigma[at]) and low <= best[at] <= high - 1
    ]

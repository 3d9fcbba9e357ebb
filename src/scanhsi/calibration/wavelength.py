"""Wavelengths of the bands, from a lamp whose lines are known (Eq. 14, figures 9 and 10).

Peaks are found and told which line they are; then the lines are fitted where they are expected, blends together, and a polynomial
goes through what came out. Over the sensor of the paper a straight line is wrong by 0.35 nm, degree 2 by 0.01 nm; degree 3 wins
nothing.

The paper prints ``lambda(p) = 370.79 + 2.68 p - 1e-4 p^2`` with p in channels of five bands, 0 to 217: that is 371 to 948 nm, not
the 400 to 1000 nm of its text, and its rounded digits leave 2.4 nm open at the far end. Here coefficients are per band, float64,
and keep their covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanhsi.calibration.assign import DispersionRange, assign_lines
from scanhsi.calibration.dispersion import Dispersion, fit_dispersion
from scanhsi.calibration.line_fit import GAUSSIAN, SHAPES, Fitted, Group, fit_group, group_lines
from scanhsi.calibration.lines import LineList, hgar
from scanhsi.calibration.peaks import find_peaks
from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

PLACE_FLOOR: Final = 0.01
"""Bands that a place is never better than: lines that no list has, and shapes that are no Gaussians."""

_OUTLYING: Final = 5.0
_BETTER: Final = 0.8  # of what a Gaussian leaves


@dataclass(frozen=True, slots=True, eq=False)
class Wavelength:
    """Wavelengths of the bands.

    Attributes:
        bands: Of the sensor region that this is for.
        coefficients: ``wavelength = sum of coefficients[k] band^k``, nm, (power,); band 0 is the first of the region.
        covariance: Of the coefficients, (power, power).
        line_nm: Lines (or groups of them) that were used, (line,).
        line_band, line_band_sigma: Where they lie, with standard errors, (line,).
        line_fwhm_nm, line_fwhm_sigma_nm: Their full widths at half maximum, (line,); nan where they say nothing of the instrument.
        residual_nm: Standard deviation of the lines around the polynomial.
        p_value: Chance of residuals as large as these from the errors of the places; nan with fewer than degree + 3 lines.
        found: Peaks found in the spectrum.
        source: Name of the list of lines.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "wavelength"

    bands: int
    coefficients: Annotated[Floats, Stored("nm", "polynomial of the band", ("power",))]
    covariance: Annotated[Floats, Stored("nm2", "covariance of the coefficients", ("power", "other_power"))]
    line_nm: Annotated[Floats, Stored("nm", "wavelengths of the lines", ("line",))]
    line_band: Annotated[Floats, Stored("1", "place of the lines, in bands", ("line",))]
    line_band_sigma: Annotated[Floats, Stored("1", "standard error of the place", ("line",))]
    line_fwhm_nm: Annotated[Floats, Stored("nm", "full width at half maximum", ("line",))]
    line_fwhm_sigma_nm: Annotated[Floats, Stored("nm", "standard error of the width", ("line",))]
    residual_nm: Annotated[float, Stored("nm", "standard deviation around the polynomial")]
    p_value: Annotated[float, Stored("1", "chance of residuals as large")]
    found: int
    source: str
    provenance: Provenance

    @property
    def dispersion(self) -> Dispersion:
        """The polynomial."""
        return Dispersion(self.coefficients, self.covariance, self.residual_nm, self.p_value)

    def nm(self, band: ArrayLike | None = None) -> Floats:
        """Wavelengths of some bands, fractions allowed; of all by default, (bands,)."""
        return self.dispersion.nm(np.arange(self.bands) if band is None else band)

    def sigma_nm(self, band: ArrayLike | None = None) -> Floats:
        """Standard error of `nm`."""
        return self.dispersion.sigma_nm(np.arange(self.bands) if band is None else band)

    def fwhm_nm(self, wavelength_nm: ArrayLike) -> Floats:
        """Spectral resolution: width of a line at some wavelengths, a straight line through those measured."""
        known = np.isfinite(self.line_fwhm_nm)
        if not known.any():
            return np.full(np.shape(wavelength_nm), np.nan)
        degree = 1 if int(known.sum()) >= 4 else 0
        width, sigma = (
            self.line_fwhm_nm[known],
            np.hypot(self.line_fwhm_sigma_nm[known], 0.01 * self.line_fwhm_nm[known]),
        )
        curve = np.polynomial.Polynomial.fit(self.line_nm[known], width, degree, w=1 / sigma)
        return cast("Floats", curve(np.asarray(wavelength_nm, np.float64)))


def calibrate_with_lamp(
    spectrum: NDArray[Any],
    provenance: Provenance,
    *,
    lines: LineList | None = None,
    prior: DispersionRange | None = None,
    degree: int = 2,
    fwhm_bands: float = 5.5,
) -> Wavelength:
    """Calibrate with the spectrum of a lamp.

    Args:
        spectrum: (bands,) mean of lines and of samples that see the lamp, dark-corrected. Smile blurs a mean over the whole
            slit: `scanhsi.calibration.smile.calibrate_spectrograph` works it out, too.
        provenance: Where it comes from.
        lines: Of the lamp; mercury-argon by default.
        prior: What the dispersion may be.
        degree: Of the polynomial.
        fwhm_bands: Roughly the width of a line in bands.

    Raises:
        CalibrationError: Saturated or noisy, or the lines are not these.
    """
    values = np.asarray(spectrum, np.float64)
    lines = lines or hgar()
    peaks = find_peaks(values, fwhm_px=fwhm_bands)
    fwhm = float(np.median(peaks.fwhm_px))
    first = identify(peaks.centre_px, fwhm, lines, prior, degree)
    fitted, _ = fit_lines(values, first, lines, fwhm, degree)
    return through(fitted, len(values), len(peaks), lines.name, degree, provenance)


def identify(centre: Floats, fwhm: float, lines: LineList, prior: DispersionRange | None, degree: int) -> Dispersion:
    """A first dispersion from the places of peaks, with lines as the instrument shows them: blends as one."""
    prior = prior or DispersionRange()
    width_nm = fwhm * sum(abs(slope) for slope in prior.nm_per_band) / 2
    return assign_lines(centre, lines.merged(0.6 * width_nm), prior=prior, degree=degree).dispersion


def fit_lines(
    spectrum: Floats, dispersion: Dispersion, lines: LineList, fwhm: float, degree: int
) -> tuple[list[Fitted], float]:
    """Fit all lines good for calibrating that show, twice: the second time with the distances that the first fit gives.

    Returns:
        The lines, and which of `SHAPES` they have.
    """
    fitted: list[Fitted] = []
    shape = GAUSSIAN
    for again in (False, True):
        good = set(lines.calibrating().wavelength_nm.tolist())
        groups = group_lines(lines, dispersion, len(spectrum), fwhm)
        groups = [group for group in groups if _has(group.wavelength_nm, good)]
        shape = _shape(spectrum, groups, fwhm) if again else GAUSSIAN
        every = (fit_group(spectrum, group, fwhm, shape=shape) for group in groups)
        fitted = [one for one in every if one is not None and one.band_sigma < 0.3]
        if len(fitted) > degree:
            dispersion = fit_dispersion(
                [one.band for one in fitted],
                [one.wavelength_nm for one in fitted],
                degree=degree,
                sigma_nm=_errors(fitted, dispersion),
            )
    return fitted, shape


def _shape(spectrum: Floats, groups: list[Group], fwhm: float) -> float:
    """The shape that leaves least of most single lines; the Gaussian unless another one is clearly better.

    Of most: a few lines that are all but saturated have flat tops of their own.
    """
    alone = [group for group in groups if len(group.band) == 1] or groups
    misfits = np.array([[_misfit(spectrum, group, fwhm, shape) for group in alone] for shape in SHAPES])
    shown = misfits[:, np.isfinite(misfits[0])]
    if not shown.size:
        return GAUSSIAN
    usual = np.median(np.where(np.isfinite(shown), shown, np.inf), axis=1)
    best = int(np.argmin(usual))
    return SHAPES[best] if usual[best] < _BETTER * usual[0] else GAUSSIAN


def _misfit(spectrum: Floats, group: Group, fwhm: float, shape: float) -> float:
    fitted = fit_group(spectrum, group, fwhm, shape=shape)
    return math.nan if fitted is None else fitted.misfit


def _has(wavelengths: Floats, good: set[float]) -> bool:
    return any(min(abs(nm - one) for one in good) < 0.5 for nm in wavelengths.tolist())


def _errors(fitted: list[Fitted], dispersion: Dispersion) -> Floats:
    sigma = np.hypot([one.band_sigma for one in fitted], PLACE_FLOOR)
    return sigma * np.abs(dispersion.nm_per_band([one.band for one in fitted]))


def through(
    fitted: list[Fitted], bands: int, found: int, source: str, degree: int, provenance: Provenance
) -> Wavelength:
    """The calibration through some lines, those that lie off left out.

    Raises:
        CalibrationError: Too few.
    """
    if len(fitted) < degree + 1:
        raise CalibrationError(
            f"{len(fitted)} lines were fitted; a polynomial of degree {degree} takes {degree + 1} at least.",
            hint="a longer exposure, or a lower degree",
        )
    while True:
        band, known = np.array([one.band for one in fitted]), np.array([one.wavelength_nm for one in fitted])
        rough = fit_dispersion(band, known, degree=degree)
        sigma = _errors(fitted, rough)
        curve = fit_dispersion(band, known, degree=degree, sigma_nm=sigma)
        off = np.abs(known - curve.nm(band))
        spread = 1.4826 * float(np.median(off))
        limit = _OUTLYING * np.maximum(sigma, spread)
        worst = int(np.argmax(off / limit))
        if off[worst] <= limit[worst] or len(fitted) <= degree + 2:
            break
        fitted = [one for index, one in enumerate(fitted) if index != worst]
    per_band = np.abs(curve.nm_per_band(band))
    return Wavelength(
        bands=bands,
        coefficients=curve.coefficients,
        covariance=curve.covariance,
        line_nm=known,
        line_band=band,
        line_band_sigma=np.array([one.band_sigma for one in fitted]),
        line_fwhm_nm=np.array([one.fwhm for one in fitted]) * per_band,
        line_fwhm_sigma_nm=np.array([one.fwhm_sigma for one in fitted]) * per_band,
        residual_nm=curve.residual_nm if math.isfinite(curve.residual_nm) else math.nan,
        p_value=curve.p_value,
        found=found,
        source=source,
        provenance=provenance,
    )

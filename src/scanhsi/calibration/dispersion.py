"""From pixel to wavelength: a polynomial through pairs that are known, and through pairs of which some are wrong (Eq. 14).

The paper asks for ``d`` pairs or more for a polynomial of degree ``d``. It has ``d + 1`` coefficients, so ``d + 1`` pairs are the
least (its own list of them has that many), and then nothing is left to judge the fit by: that takes ``d + 3``.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

MAX_DEGREE: Final = 5
SPARE_FOR_A_TEST: Final = 3  # pairs above the degree that a test of the residuals needs: erratum 12
_SUBSETS: Final = 5_000
_CHANCE: Final = 0.005  # that a good pair is rejected
_EXACT_NM: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Dispersion:
    """A polynomial ``wavelength = sum of coefficients[k] band^k``.

    Attributes:
        coefficients: In nm per band^k, (power,).
        covariance: Of the coefficients, (power, power).
        residual_nm: Standard deviation of the pairs around it, degrees of freedom accounted for; nan where none is left.
        p_value: Chance of residuals as large as these if the errors given are right; nan with fewer than degree + 3 pairs.
    """

    coefficients: Floats
    covariance: Floats
    residual_nm: float
    p_value: float

    @property
    def degree(self) -> int:
        """Of the polynomial."""
        return len(self.coefficients) - 1

    def nm(self, band: ArrayLike) -> Floats:
        """Wavelength at a band, which may be a fraction."""
        return _value(np.asarray(band, np.float64), self.coefficients)

    def sigma_nm(self, band: ArrayLike) -> Floats:
        """Standard error of `nm`."""
        powers = np.asarray(band, np.float64)[..., None] ** np.arange(self.degree + 1)
        variance = np.einsum("...i,ij,...j->...", powers, self.covariance, powers)
        return np.sqrt(np.maximum(variance, 0))

    def nm_per_band(self, band: ArrayLike) -> Floats:
        """Change of the wavelength from one band to the next."""
        return _value(np.asarray(band, np.float64), self.coefficients[1:] * np.arange(1, self.degree + 1))


def _value(place: Floats, coefficients: Floats) -> Floats:
    return cast("Floats", np.polynomial.polynomial.polyval(place, coefficients))


def fit_dispersion(
    band: ArrayLike, wavelength_nm: ArrayLike, *, degree: int = 2, sigma_nm: ArrayLike | None = None
) -> Dispersion:
    """Fit the polynomial by weighted least squares.

    Args:
        band: Places, with fractions, (pair,).
        wavelength_nm: Their wavelengths, (pair,).
        degree: Of the polynomial; 2 serves the paper's instrument best.
        sigma_nm: Standard errors of the pairs, (pair,) or one for all; where the pairs scatter more, the covariance says so. None:
            all alike, by their scatter.

    Raises:
        CalibrationError: Fewer than ``degree + 1`` pairs, pairs that are no numbers, or all at one place.
    """
    places, known = _pairs(band, wavelength_nm, degree)
    sigma = np.ones_like(places) if sigma_nm is None else np.broadcast_to(np.asarray(sigma_nm, float), places.shape)
    if not (np.isfinite(sigma).all() and (sigma > 0).all()):
        raise CalibrationError("the errors of the pairs have to be positive numbers.")
    to_band = _powers_from_scaled(places, degree)
    scaled = (places - places.mean()) / max(float(np.ptp(places)) / 2, 1e-9)
    design = scaled[:, None] ** np.arange(degree + 1) / sigma[:, None]
    best = cast("Floats", np.linalg.lstsq(design, known / sigma, rcond=None)[0])
    covariance = cast("Floats", np.linalg.inv(design.T @ design))
    left = known / sigma - design @ best
    freedom = len(places) - degree - 1
    chi_square = float(np.sum(left**2))
    scatter = chi_square / freedom if freedom else 1.0
    if sigma_nm is not None:
        scatter = max(scatter, 1.0)
    elif not freedom:
        scatter = math.nan
    unweighted: Floats = known - scaled[:, None] ** np.arange(degree + 1) @ best
    tested = sigma_nm is not None and len(places) >= degree + SPARE_FOR_A_TEST
    return Dispersion(
        coefficients=to_band @ best,
        covariance=to_band @ (covariance * scatter) @ to_band.T,
        residual_nm=math.sqrt(float(np.sum(unweighted**2)) / freedom) if freedom else math.nan,
        p_value=float(special.chdtrc(freedom, chi_square)) if tested else math.nan,
    )


def fit_dispersion_robustly(
    band: ArrayLike, wavelength_nm: ArrayLike, *, degree: int = 2, seed: int = 0
) -> tuple[Dispersion, NDArray[np.bool_]]:
    """Fit the polynomial to pairs of which some, fewer than half, are wrong.

    The polynomial through few pairs that leaves the smallest median residual (least median of squares) tells which half of the
    pairs is good. The others are added one by one, nearest first, as long as they lie where the fit so far expects them to.

    Args:
        band: Places, (pair,).
        wavelength_nm: Their wavelengths, (pair,).
        degree: Of the polynomial.
        seed: Of the choice of pairs, where there are too many to try all.

    Returns:
        The polynomial, and which pairs it rests on, (pair,).

    Raises:
        CalibrationError: Fewer than ``degree + 3`` pairs, or as `fit_dispersion`.
    """
    places, known = _pairs(band, wavelength_nm, degree)
    if len(places) < degree + SPARE_FOR_A_TEST:
        raise CalibrationError(
            f"{len(places)} pairs cannot tell a wrong one from a curve of degree {degree}.",
            hint=f"{degree + SPARE_FOR_A_TEST} pairs at least, or a lower degree",
        )
    good = _least_median(places, known, degree, seed)
    while not good.all():
        fit = fit_dispersion(places[good], known[good], degree=degree)
        spread = np.hypot(
            fit.residual_nm, fit.sigma_nm(places)
        )  # a pair that is not in the fit scatters, and so does the fit
        off = np.where(good, np.inf, np.abs(known - fit.nm(places)) / np.maximum(spread, _EXACT_NM))
        nearest = int(np.argmin(off))
        if off[nearest] > -special.stdtrit(int(good.sum()) - degree - 1, _CHANCE / 2):
            break
        good[nearest] = True
    return fit_dispersion(places[good], known[good], degree=degree), good


def _least_median(places: Floats, known: Floats, degree: int, seed: int) -> NDArray[np.bool_]:
    count = len(places)
    half = (count + degree + 2) // 2
    best, scale = np.ones(count, bool), math.inf
    unit = (places - places.mean()) / np.ptp(places)
    for subset in _subsets(count, degree + 1, seed):
        chosen = np.array(subset)
        if len(np.unique(unit[chosen])) <= degree:
            continue
        curve = cast("Floats", np.polynomial.polynomial.polyfit(unit[chosen], known[chosen], degree))
        left = np.abs(known - _value(unit, curve))
        order = np.argsort(left, kind="stable")
        if left[order[half - 1]] < scale:
            scale = float(left[order[half - 1]])
            best = np.zeros(count, bool)
            best[order[:half]] = True
    return best


def _subsets(count: int, size: int, seed: int) -> list[tuple[int, ...]]:
    if math.comb(count, size) <= _SUBSETS:
        return list(itertools.combinations(range(count), size))
    rng = np.random.default_rng(seed)
    return [tuple(rng.choice(count, size, replace=False).tolist()) for _ in range(_SUBSETS)]


def _pairs(band: ArrayLike, wavelength_nm: ArrayLike, degree: int) -> tuple[Floats, Floats]:
    places, known = np.asarray(band, np.float64), np.asarray(wavelength_nm, np.float64)
    if not 1 <= degree <= MAX_DEGREE:
        raise CalibrationError(f"degree {degree} is no sensible one: 1 to {MAX_DEGREE}.")
    if places.ndim != 1 or places.shape != known.shape:
        raise CalibrationError(f"{places.shape} places and {known.shape} wavelengths do not go together.")
    if not (np.isfinite(places).all() and np.isfinite(known).all()):
        raise CalibrationError("some pairs of band and wavelength are no numbers.")
    if len(np.unique(places)) < degree + 1:
        raise CalibrationError(
            f"a polynomial of degree {degree} has {degree + 1} coefficients: {len(np.unique(places))} places are too few.",
            hint=f"{degree + 1} lines at least, {degree + SPARE_FOR_A_TEST} to judge the fit, or a lower degree",
        )
    return places, known


def _powers_from_scaled(places: Floats, degree: int) -> Floats:
    """Matrix from the coefficients over ``(band - mean) / half range`` to those over the band."""
    mean, half = float(places.mean()), max(float(np.ptp(places)) / 2, 1e-9)
    matrix = np.zeros((degree + 1, degree + 1))
    power = np.ones(1)
    for column in range(degree + 1):
        matrix[: column + 1, column] = power
        power = cast("Floats", np.polynomial.polynomial.polymul(power, np.array([-mean / half, 1 / half])))
    return matrix

"""Keystone: how the place along the slit changes with the band.

A target with edges, bars or slits across the slit is seen in all bands. What it looks like in the middle band is laid over what it
looks like in others, piece by piece along the slit: how far it has to be moved is the keystone there. Nothing has to be known of
the target, and its brightness may change with the band.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate

from scanhsi.calibration.peaks import noise_of
from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_POWERS: Final = (1, 2)  # of the band
_GROUPS: Final = 40  # of bands
_WINDOWS: Final = 12  # along the slit
_LEAST_WINDOW: Final = 16
_SHARPEST: Final = 0.25  # samples: standard error of a place that is of use
_REACH: Final = 3.0  # samples a piece may be moved
_STRUCTURE: Final = 5.0  # standard deviations of the noise: a piece that varies less shows nothing
_EVEN: Final = 1e-6  # of the level: what varies less does not vary
_NO_STRUCTURE: Final = "no structure along the slit can be followed over the bands."
_FLOOR: Final = 0.005  # samples that a place is never better than
_OUTLYING: Final = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Keystone:
    """Where light of one place falls along the bands.

    With ``u`` from -1 to 1 over the bands and ``t`` from -1 to 1 over the samples, what falls on a sample in the middle band falls
    ``sum of coefficients[m - 1, k] u^m t^k`` samples further in another.

    Attributes:
        bands, samples: Of the sensor region that this is for.
        coefficients, coefficients_sigma: In samples, (band_power, sample_power), with standard errors.
        residual_samples: Standard deviation of the places around the fit.
        band: Middle of each group of bands that was compared, (group,).
        sample: Where the structure of each piece of the slit is, (piece,).
        moved: How far each piece lies from where it lies in the middle band, in samples, (group, piece); nan where it is not
            to be told.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "keystone"

    bands: int
    samples: int
    coefficients: Annotated[Floats, Stored("1", "shift in samples", ("band_power", "sample_power"))]
    coefficients_sigma: Annotated[Floats, Stored("1", "standard error", ("band_power", "sample_power"))]
    residual_samples: Annotated[float, Stored("1", "standard deviation around the fit, in samples")]
    band: Annotated[Floats, Stored("1", "middle band of a group", ("group",))]
    sample: Annotated[Floats, Stored("1", "middle sample of a piece", ("piece",))]
    moved: Annotated[Floats, Stored("1", "shift of a piece, in samples", ("group", "piece"))]
    provenance: Provenance

    def shift(self, band: ArrayLike | None = None, sample: ArrayLike | None = None) -> Floats:
        """Samples by which what falls on a sample in the middle band falls further in another; (band, sample) by default."""
        rows = np.arange(self.bands)[:, None] if band is None else np.asarray(band, np.float64)
        columns = np.arange(self.samples) if sample is None else np.asarray(sample, np.float64)
        terms = _terms(_even(rows, self.bands), _even(columns, self.samples))
        return cast("Floats", sum(term * value for term, value in zip(terms, self.coefficients.flat, strict=True)))

    @property
    def largest_samples(self) -> float:
        """Largest change of place over the bands, of any sample."""
        return float(np.ptp(self.shift(), axis=0).max())


def _even(index: ArrayLike, count: int) -> Floats:
    return 2 * np.asarray(index, np.float64) / max(count - 1, 1) - 1


def _terms(u: Floats, t: Floats) -> list[Floats]:
    """Terms of the shift in the order of the coefficients."""
    return [u**power * t**order for power in _POWERS for order in (0, 1)]


def fit_keystone(frame: NDArray[Any], provenance: Provenance) -> Keystone:
    """Fit the keystone to a frame of a target that is structured along the slit.

    Args:
        frame: (band, sample), mean of some lines, dark-corrected; bands with nan are left out.
        provenance: Where it comes from.

    Raises:
        CalibrationError: Too small, or without structure along the slit.
    """
    values = np.asarray(frame, np.float64)
    if values.ndim != 2 or values.shape[0] < 10 or values.shape[1] < 2 * _LEAST_WINDOW:
        raise CalibrationError(
            f"a keystone takes 10 bands and {2 * _LEAST_WINDOW} samples at least, not {values.shape}."
        )
    bands, samples = values.shape
    cuts = np.unique(np.arange(_GROUPS + 1) * bands // _GROUPS)
    middle = (cuts[:-1] + cuts[1:] - 1) / 2
    profiles = np.add.reduceat(values, cuts[:-1], axis=0) / np.diff(cuts)[:, None]
    centre = slice(round(0.46 * bands), max(round(0.54 * bands), round(0.46 * bands) + 1))
    reference = cast("Floats", values[centre].mean(axis=0))
    if not np.isfinite(reference).all():
        raise CalibrationError("the middle bands are saturated.", hint="a shorter exposure")
    noise = max(noise_of(reference), _EVEN * float(np.abs(reference).max()))
    windows = [window for window in _windows(samples) if _structure(reference[window]) > _STRUCTURE * noise]
    if not windows:
        raise CalibrationError(_NO_STRUCTURE, hint="lay a grid or an edge across the slit")
    moved = np.full((len(profiles), len(windows)), np.nan)
    sigma = np.full_like(moved, np.nan)
    for column, window in enumerate(windows):
        for row, profile in enumerate(profiles):
            moved[row, column], sigma[row, column] = _moved(profile, reference, window)
    return _fit(
        moved, sigma, middle, np.array([_weight_place(reference, one) for one in windows]), values.shape, provenance
    )


def _windows(samples: int) -> list[slice]:
    margin = math.ceil(_REACH)
    size = max(_LEAST_WINDOW, samples // _WINDOWS)
    count = max(1, (samples - 2 * margin) // size)
    cuts = (margin + np.arange(count + 1) * (samples - 2 * margin) // count).tolist()
    return [slice(low, high) for low, high in pairwise(cuts)]


def _weight_place(reference: Floats, window: slice) -> float:
    """Where in a window the slopes are that tell a shift: not always its middle."""
    weight = cast("Floats", np.gradient(reference))[window] ** 2
    place: Floats = np.arange(len(weight), dtype=np.float64)
    return window.start + float(np.average(place, weights=weight))


def _structure(part: Floats) -> float:
    """Standard deviation around a straight line: light that falls off is no structure."""
    place: Floats = np.arange(len(part), dtype=np.float64)
    design = np.stack((np.ones_like(place), place), axis=1)
    level = cast("Floats", np.linalg.lstsq(design, part, rcond=None)[0])
    return float(np.std(part - design @ level))


def _moved(profile: Floats, reference: Floats, window: slice) -> tuple[float, float]:
    """How far a profile lies from the reference within a window, and the standard error; nan where that is not to be told.

    Level and height of the reference are fitted with it.
    """
    nothing = (math.nan, math.nan)
    part = profile[window]
    if not np.isfinite(part).all():
        return nothing
    curve = interpolate.CubicSpline(np.arange(len(reference)), reference)
    slope = cast("Any", curve.derivative())
    place: Floats = np.arange(window.start, window.stop, dtype=np.float64)
    shift, best = 0.0, np.zeros(3)
    design = np.zeros((len(place), 3))
    for _ in range(10):
        there, rise = cast("tuple[Floats, Floats]", (curve(place - shift), slope(place - shift)))
        design = np.stack((np.ones_like(place), there, rise), axis=1)
        best = cast("Floats", np.linalg.lstsq(design, part, rcond=1e-9)[0])
        if best[1] <= 0:
            return nothing
        step = float(np.clip(-best[2] / best[1], -1, 1))
        shift += step
        if abs(shift) > _REACH:
            return nothing
        if abs(step) < 1e-5:
            break
    left: Floats = part - design @ best
    variance = max(float(np.sum(left**2)) / (len(part) - 3), noise_of(profile) ** 2, 1e-24)
    error = math.sqrt(variance * float(np.linalg.pinv(design.T @ design)[2, 2])) / float(best[1])
    return (shift, error) if error < _SHARPEST else nothing


def _fit(
    moved: Floats, sigma: Floats, band: Floats, sample: Floats, shape: tuple[int, ...], provenance: Provenance
) -> Keystone:
    bands, samples = shape
    row, column = np.nonzero(np.isfinite(moved))
    if len(np.unique(row)) < 8:
        raise CalibrationError(_NO_STRUCTURE, hint="lay a grid or an edge across the slit")
    t = _even(sample, samples)
    terms = np.stack(_terms(_even(band, bands)[row], t[column]), axis=1)
    known = np.ones(terms.shape[1], bool)
    if np.ptp(t[column]) < 0.4:  # one edge tells where it is itself, not how the slit is stretched
        known[1::2] = False
    place, error = moved[row, column], np.hypot(sigma[row, column], _FLOOR)
    good = np.ones(len(place), bool)
    design, best, left = terms[:, known], np.zeros(int(known.sum())), place
    for _ in range(5):
        weighted = design[good] / error[good, None]
        best = cast("Floats", np.linalg.lstsq(weighted, place[good] / error[good], rcond=1e-10)[0])
        left = place - design @ best
        again = np.abs(left) <= _OUTLYING * np.maximum(error, 1.4826 * np.median(np.abs(left[good])))
        if (again == good).all():
            break
        good = again
    weighted = design[good] / error[good, None]
    freedom = max(int(good.sum()) - len(best), 1)
    scatter = max(1.0, float(np.sum((left[good] / error[good]) ** 2)) / freedom)
    coefficients, spread = np.zeros(len(known)), np.full(len(known), np.nan)
    coefficients[known] = best
    spread[known] = np.sqrt(np.diag(np.linalg.pinv(weighted.T @ weighted)) * scatter)
    return Keystone(
        bands=bands,
        samples=samples,
        coefficients=coefficients.reshape(len(_POWERS), 2),
        coefficients_sigma=spread.reshape(len(_POWERS), 2),
        residual_samples=math.sqrt(float(np.sum(left[good] ** 2)) / freedom),
        band=band,
        sample=sample,
        moved=moved,
        provenance=provenance,
    )

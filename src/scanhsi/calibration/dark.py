"""Dark signal: what a pixel reads without light, as a line over the exposure time (Eq. 15 of the paper).

``h = a T_exp + b``: `a` is dark current, `b` offset. Fitted per pixel by weighted least squares from running
moments, so that memory does not grow with the number of frames. A handful of frames tells the noise of one pixel only roughly, and
weights that are wrong make standard errors that are wrong: so the noise is taken as one law of all pixels, read noise plus shot
noise of the dark current, and a pixel's own noise only where it clearly exceeds that law.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy import special

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_PIXEL = ("band", "sample")

_QUANTISATION = 1 / 12
"""Variance of rounding to whole counts, counts^2: a camera without noise has at least this."""

_SHOULDER = 0.95
"""Quantile that tells how wide the dark currents scatter: some percent of hot pixels do not move it much."""

_MOST_SKEW = 20.0
"""Ratio of the quantiles' distances from the median: a log-normal spread of 1.8 has this, no sensor has more."""

_NOISIER = 1e-5
"""So unlikely must the variance of a pixel's frames be under the law of all pixels before its own is believed."""


@dataclass(frozen=True, slots=True, eq=False)
class DarkModel:
    """Dark counts of every pixel at any exposure within the range measured.

    Attributes:
        rate: Dark current, (band, sample).
        offset: Counts at no exposure, (band, sample).
        rate_sigma, offset_sigma: Standard errors.
        covariance: Of rate and offset.
        noise: Temporal noise at the shortest exposure, (band, sample).
        hot: Pixels whose dark current, or dark counts at the longest exposure, stand out, (band, sample) bool.
        nonlinear: Pixels that are no line over the exposure, (band, sample) bool.
        shortest_s, longest_s: Exposures measured; the model says nothing beyond the longest.
        frames: Frames used in all.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "dark"

    rate: Annotated[Floats, Stored("counts s-1", "dark current", _PIXEL)]
    offset: Annotated[Floats, Stored("counts", "dark offset", _PIXEL)]
    rate_sigma: Annotated[Floats, Stored("counts s-1", "standard error of the dark current", _PIXEL)]
    offset_sigma: Annotated[Floats, Stored("counts", "standard error of the offset", _PIXEL)]
    covariance: Annotated[Floats, Stored("counts2 s-1", "covariance of dark current and offset", _PIXEL)]
    noise: Annotated[Floats, Stored("counts", "temporal noise at the shortest exposure", _PIXEL)]
    hot: Annotated[NDArray[np.bool_], Stored("1", "dark current stands out", _PIXEL)]
    nonlinear: Annotated[NDArray[np.bool_], Stored("1", "not a line over the exposure", _PIXEL)]
    shortest_s: Annotated[float, Stored("s", "shortest exposure measured")]
    longest_s: Annotated[float, Stored("s", "longest exposure measured")]
    frames: Annotated[int, Stored("1", "frames used")]
    provenance: Provenance

    def at(self, exposure_s: float) -> Floats:
        """Dark counts at an exposure, (band, sample).

        Raises:
            CalibrationError: Longer than any exposure measured: an extrapolation would look like knowledge.
        """
        if not 0 <= exposure_s <= self.longest_s * 1.001:
            raise CalibrationError(
                f"the dark model was measured up to {self.longest_s:g} s; it says nothing of {exposure_s:g} s.",
                hint=f"measure darks up to {exposure_s:g} s",
            )
        return self.rate * exposure_s + self.offset

    def sigma_at(self, exposure_s: float) -> Floats:
        """Standard error of `at`, (band, sample)."""
        variance = (self.rate_sigma * exposure_s) ** 2 + self.offset_sigma**2 + 2 * exposure_s * self.covariance
        return np.sqrt(np.maximum(variance, 0))


@dataclass(slots=True, eq=False)
class _Group:
    """Running moments of the frames of one exposure (Welford), so that nothing grows with their number."""

    count: int
    mean: Floats
    squares: Floats

    def add(self, frame: NDArray[Any]) -> None:
        self.count += 1
        delta = frame - self.mean
        self.mean += delta / self.count
        self.squares += delta * (frame - self.mean)


class DarkFit:
    """Takes dark frames one by one, in any order of exposures, and fits when asked.

    Memory is two frames of float64 for each exposure, whatever the number of frames.
    """

    def __init__(self) -> None:
        self._groups: dict[float, _Group] = {}
        self._saturated: NDArray[np.bool_] | None = None

    def add(self, exposure_s: float, frame: NDArray[Any], *, saturation: float | None = None) -> None:
        """Take one dark frame, (band, sample) counts.

        Raises:
            CalibrationError: Of another shape than those before, or not finite.
        """
        if frame.ndim != 2 or not frame.size:
            raise CalibrationError(f"a dark frame has two axes, band and sample, not the shape {frame.shape}.")
        if not exposure_s > 0:
            raise CalibrationError(f"an exposure of {exposure_s:g} s is none.")
        if frame.dtype.kind == "f" and not np.isfinite(frame).all():
            raise CalibrationError("a dark frame holds values that are no numbers.")
        if self._saturated is None:
            self._saturated = np.zeros(frame.shape, bool)
        if frame.shape != self._saturated.shape:
            raise CalibrationError(f"dark frames of {frame.shape} and {self._saturated.shape} do not go together.")
        if saturation is not None:
            self._saturated |= frame >= saturation
        group = self._groups.get(exposure_s)
        if group is None:
            group = self._groups[exposure_s] = _Group(0, np.zeros(frame.shape), np.zeros(frame.shape))
        group.add(frame.astype(np.float64))

    def fit(
        self, provenance: Provenance | None = None, *, hot_sigma: float = 6.0, linear_sigma: float = 5.0
    ) -> DarkModel:
        """Fit the model.

        Args:
            provenance: Where the frames come from.
            hot_sigma: A pixel is hot when its dark current, or its counts at the longest exposure, lie as far above the median as
                so many standard deviations of a normal distribution would, the skew of the distribution accounted for; or when it
                saturated.
            linear_sigma: A pixel is nonlinear when the chi-square of its residuals is that unlikely, in standard deviations of a
                normal distribution.

        Raises:
            CalibrationError: Fewer than two exposures, or fewer than two frames of each.
        """
        exposures = np.array(sorted(self._groups))
        if len(exposures) < 2:
            raise CalibrationError(
                f"dark frames at {len(exposures)} exposure{'s' * (len(exposures) != 1)} are no line.",
                hint="take them at two exposures or more, better at eight from 10 ms to the longest you use",
            )
        if few := [f"{exposure:g} s" for exposure in exposures if self._groups[exposure].count < 2]:
            raise CalibrationError(f"one frame shows no noise: more than one is needed at {', '.join(few)}.")
        assert self._saturated is not None
        return _fit(self._groups, exposures, self._saturated, provenance or Provenance(), hot_sigma, linear_sigma)


def fit_dark(
    frames: Iterable[tuple[float, NDArray[Any]]],
    provenance: Provenance | None = None,
    *,
    saturation: float | None = None,
) -> DarkModel:
    """Fit a `DarkModel` to pairs of exposure in s and frame, (band, sample) counts; see `DarkFit`."""
    fit = DarkFit()
    for exposure_s, frame in frames:
        fit.add(exposure_s, frame, saturation=saturation)
    return fit.fit(provenance)


def _fit(
    groups: dict[float, _Group],
    exposures: Floats,
    saturated: NDArray[np.bool_],
    provenance: Provenance,
    hot_sigma: float,
    linear_sigma: float,
) -> DarkModel:
    # Exposure by exposure, never all at once: full frames in float64 are 10 MB each.
    parts = [groups[exposure] for exposure in exposures.tolist()]
    law = _NoiseLaw.of(parts, exposures)
    total, moment, second, level, slope = (np.zeros(saturated.shape) for _ in range(5))
    for exposure, group in zip(exposures.tolist(), parts, strict=True):
        weight = group.count / law.variance(group, exposure)
        total += weight
        level += weight * group.mean
        weight *= exposure
        moment += weight
        slope += weight * group.mean
        weight *= exposure
        second += weight
    determinant: Floats = total * second - moment**2
    rate: Floats = (total * slope - moment * level) / determinant
    offset: Floats = (second * level - moment * slope) / determinant
    residuals = np.zeros(saturated.shape)
    for exposure, group in zip(exposures.tolist(), parts, strict=True):
        residuals += group.count / law.variance(group, exposure) * (group.mean - rate * exposure - offset) ** 2
    return DarkModel(
        rate=rate,
        offset=offset,
        rate_sigma=np.sqrt(total / determinant),
        offset_sigma=np.sqrt(second / determinant),
        covariance=-moment / determinant,
        noise=np.sqrt(law.variance(parts[0], float(exposures[0]))),
        hot=_stands_out(rate, hot_sigma) | _stands_out(parts[-1].mean, hot_sigma) | saturated,
        nonlinear=_unlikely(residuals, len(exposures) - 2, linear_sigma),
        shortest_s=float(exposures[0]),
        longest_s=float(exposures[-1]),
        frames=sum(group.count for group in parts),
        provenance=provenance,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _NoiseLaw:
    """Variance of a frame in counts^2 as a law of all pixels: read noise, plus shot noise of the dark current.

    Attributes:
        read, shot: Of the law.
        rate: Dark current of each pixel, roughly, (band, sample).
    """

    read: float
    shot: float
    rate: Floats

    @classmethod
    def of(cls, groups: list[_Group], exposures: Floats) -> Self:
        """The law through what the frames of all pixels but the hottest scatter: a straight line over the dark counts."""
        time: Floats = exposures - exposures.mean()
        rate: Floats = np.zeros(groups[0].mean.shape)  # unweighted: good enough to weigh with
        for one, group in zip(time.tolist(), groups, strict=True):
            rate += one * group.mean
        rate = np.maximum(rate / np.sum(time**2), 0)
        where = rate <= np.quantile(rate, 0.99)
        usual = rate[where]
        own: Floats = np.array([float(group.squares[where].mean()) / (group.count - 1) for group in groups])
        mean, square = float(usual.mean()), float(np.mean(usual**2))
        product = sum(
            exposure * float(np.mean(usual * group.squares[where])) / (group.count - 1)
            for exposure, group in zip(exposures.tolist(), groups, strict=True)
        )
        middle = float(exposures.mean()) * mean
        spread = float(np.mean(exposures**2)) * square - middle**2
        slope = (product / len(groups) - middle * float(own.mean())) / spread if spread > 0 else 0.0
        return cls(max(float(own.mean()) - slope * middle, _QUANTISATION), max(slope, 0.0), rate)

    def variance(self, group: _Group, exposure_s: float) -> Floats:
        """Of a frame of an exposure: by the law, or more where a pixel clearly shows more, (band, sample)."""
        degrees = group.count - 1
        law = self.read + self.shot * exposure_s * self.rate
        own = group.squares / degrees
        return np.where(own * degrees > float(special.chdtri(degrees, _NOISIER)) * law, own, law)


def _unlikely(chi_square: Floats, degrees: int, sigma: float) -> NDArray[np.bool_]:
    if degrees < 1:
        return np.zeros(chi_square.shape, bool)
    return chi_square > special.chdtri(degrees, special.ndtr(-sigma))


def _stands_out(values: Floats, sigma: float) -> NDArray[np.bool_]:
    """Values far above the others, whose distribution may be skewed.

    Dark currents scatter more like a log-normal distribution than like a normal one, with the noise of the measurement on top: what
    is beyond six sigma for one is common for the other. So a shifted log-normal, of which the normal is the limit, goes through
    three quantiles of the values: ``x(z) = median + above (r^(z / z95) - 1) / (r - 1)`` with the ratio r of the distances from the
    median to the quantiles at z95 above and below it.
    """
    low, median, high = np.quantile(values, (1 - _SHOULDER, 0.5, _SHOULDER)).tolist()
    above, below = high - median, median - low
    steps = sigma / float(special.ndtri(_SHOULDER))
    skew = min(above / below, _MOST_SKEW) if below > 0 else 1.0
    limit = steps * above if skew < 1.001 else above * (skew**steps - 1) / (skew - 1)
    return values > median + max(limit, 0.0)

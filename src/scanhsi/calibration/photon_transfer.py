"""Photon transfer: what the sensor makes of photons, a subset of EMVA 1288 release 4.

From pairs of flat frames at several exposures and pairs of dark frames at the same ones: the variance of a pair's difference
grows with the dark-corrected mean by the gain of the system (counts per electron), from a level that is the read noise. Everything
is in counts and electrons; photons would need a calibrated source, which line scanners rarely stand before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_QUANTISATION: Final = 1 / 12
_GAIN_RANGE: Final = 0.7
_FLAT: Final = 0.1  # of the growth that the exposure would give: the signal grows no more
_LINEAR_RANGE: Final = (0.05, 0.95)
_EXPOSURE = ("exposure",)


@dataclass(frozen=True, slots=True, eq=False)
class FlatPair:
    """Two frames of a flat, constant light, and two dark ones, at one exposure.

    Attributes:
        exposure_s: Exposure time.
        flat: (2, band, sample) counts.
        dark: (2, band, sample) counts.
    """

    exposure_s: float
    flat: NDArray[Any]
    dark: NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class PhotonTransfer:
    """The sensor in numbers. dB are 20 log10 of a ratio of amplitudes.

    Attributes:
        gain, gain_sigma: Counts per electron, with its standard error.
        read_noise_e: Temporal noise in the dark at no exposure, electrons, without that of rounding.
        saturation_e: Electrons at saturation as EMVA 1288 has it: where the variance of the flats is largest. Noise, PRNU and
            uneven light clip the brightest pixels before the mean one is full, and exposures are some percent apart: 2 to 9 %
            below the full well.
        full_well_e: Electrons at which the signal stops growing, because pixels are full or the converter is at its full scale;
            nan where the longest exposure does not reach that.
        snr_max_db: Signal to noise at saturation.
        dynamic_range_db: Saturation over the smallest signal that can be told from noise (signal to noise of 1).
        dsnu_e: Spatial standard deviation of the dark frames, temporal noise removed, electrons.
        prnu: Spatial standard deviation of the response at half saturation, relative.
        linearity_error: Mean deviation from the line through the dark-corrected means, 5 to 95 % of saturation, relative.
        exposure_s: Exposures, (exposure,).
        signal: Dark-corrected means, counts, (exposure,).
        variance: Temporal variance less that of the dark, counts^2, (exposure,).
        pixels: Pixels used.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "photon-transfer"

    gain: Annotated[float, Stored("counts electron-1", "system gain K")]
    gain_sigma: Annotated[float, Stored("counts electron-1", "standard error of the gain")]
    read_noise_e: Annotated[float, Stored("electron", "temporal dark noise")]
    saturation_e: Annotated[float, Stored("electron", "saturation capacity, at the largest variance")]
    full_well_e: Annotated[float, Stored("electron", "where the signal stops growing")]
    snr_max_db: Annotated[float, Stored("dB", "signal to noise at saturation")]
    dynamic_range_db: Annotated[float, Stored("dB", "dynamic range")]
    dsnu_e: Annotated[float, Stored("electron", "dark signal non-uniformity")]
    prnu: Annotated[float, Stored("1", "photo response non-uniformity")]
    linearity_error: Annotated[float, Stored("1", "mean deviation from the line")]
    exposure_s: Annotated[Floats, Stored("s", "exposures", _EXPOSURE)]
    signal: Annotated[Floats, Stored("counts", "dark-corrected means", _EXPOSURE)]
    variance: Annotated[Floats, Stored("counts2", "temporal variance less that of the dark", _EXPOSURE)]
    pixels: Annotated[int, Stored("1", "pixels used")]
    provenance: Provenance


def photon_transfer(
    pairs: Sequence[FlatPair],
    provenance: Provenance,
    *,
    mask: NDArray[np.bool_] | None = None,
    light: Floats | None = None,
    lit: NDArray[np.bool_] | None = None,
) -> PhotonTransfer:
    """Work out the photon transfer of a region that is evenly lit.

    Args:
        pairs: One an exposure, from dark to saturated; eight or more.
        provenance: Where they come from.
        mask: (band, sample), pixels to use; all by default. A spectrograph's frame is never evenly lit: take a region of it.
        light: (band, sample), the light on the pixels, smooth, in any unit: what of it varies over the region does not count as
            non-uniformity of the response.
        lit: (band, sample), more pixels, lit no brighter, from which gain, read noise and DSNU are taken, which need many pixels
            and no even light; those of the mask by default.

    Raises:
        CalibrationError: Too few exposures, no saturation reached, frames that do not go together, or no light.
    """
    pairs = sorted(pairs, key=lambda pair: pair.exposure_s)
    region = _region(pairs, mask)
    signal, variance = (np.array(values) for values in zip(*(_moments(pair, region) for pair in pairs), strict=True))
    top = _saturation(signal, variance)
    below = [pair for pair, level in zip(pairs[:top], signal, strict=False) if level <= _GAIN_RANGE * signal[top]]
    wide = region if lit is None else region | lit
    gain, gain_sigma = _gain([_moments(pair, wide) for pair in below], int(wide.sum()))
    dark_variance = _read_variance(pairs, wide)
    read_e = math.sqrt(max(dark_variance - _QUANTISATION, 0.0)) / gain
    full_e = float(signal[top]) / gain
    smallest_e = math.sqrt(dark_variance) / gain + 0.5  # EMVA 1288: where the signal to noise ratio is 1
    return PhotonTransfer(
        gain=gain,
        gain_sigma=gain_sigma,
        read_noise_e=read_e,
        saturation_e=full_e,
        full_well_e=_full_counts(pairs, signal, region) / gain,
        snr_max_db=10 * math.log10(full_e),
        dynamic_range_db=20 * math.log10(full_e / smallest_e),
        dsnu_e=_spatial(pairs[0].dark, wide) / gain,
        prnu=_prnu(pairs, signal, top, region, np.ones(region.shape) if light is None else light),
        linearity_error=_linearity_error(np.array([pair.exposure_s for pair in pairs]), signal, top),
        exposure_s=np.array([pair.exposure_s for pair in pairs]),
        signal=signal,
        variance=variance,
        pixels=int(region.sum()),
        provenance=provenance,
    )


def _region(pairs: Sequence[FlatPair], mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    if len(pairs) < 5:
        raise CalibrationError(
            f"photon transfer needs five exposures at least, not {len(pairs)}.", hint="take 10, evenly up to saturation"
        )
    shape = pairs[0].flat.shape[1:]
    for pair in pairs:
        if pair.flat.shape != (2, *shape) or pair.dark.shape != (2, *shape):
            raise CalibrationError(
                f"two flat and two dark frames of {shape} are needed at {pair.exposure_s:g} s, not {pair.flat.shape} and "
                f"{pair.dark.shape}."
            )
        if not all(np.isfinite(frames).all() for frames in (pair.flat, pair.dark)):
            raise CalibrationError(f"the frames at {pair.exposure_s:g} s hold values that are no numbers.")
    region = np.ones(shape, bool) if mask is None else mask
    if region.shape != shape or region.sum() < 100:
        raise CalibrationError(f"100 pixels of {shape} are needed at least; the mask leaves {int(region.sum())}.")
    return region


def _moments(pair: FlatPair, region: NDArray[np.bool_]) -> tuple[float, float]:
    """Dark-corrected mean, and temporal variance less that of the dark."""
    mean = pair.flat[:, region].mean(dtype=np.float64) - pair.dark[:, region].mean(dtype=np.float64)
    return float(mean), _difference_variance(pair.flat, region) - _difference_variance(pair.dark, region)


def _difference_variance(frames: NDArray[Any], region: NDArray[np.bool_]) -> float:
    """Temporal variance from the difference of two frames, in which everything that stays has gone."""
    first, second = frames[:, region].astype(np.float64)
    return float(np.var(first - second)) / 2


def _saturation(signal: Floats, variance: Floats) -> int:
    """Index of the exposure at saturation: the variance of clipped pixels falls, so it is largest just before."""
    top = int(np.argmax(variance))
    if top < 2 or signal[top] <= 0:
        raise CalibrationError(
            "the flats hold no light, or are saturated from the start.", hint="shorter exposures, or less light"
        )
    if top == len(signal) - 1:
        raise CalibrationError(
            "no flat is saturated, so the full well is not known.", hint="expose until the variance falls again"
        )
    return top


def _full_counts(pairs: Sequence[FlatPair], signal: Floats, region: NDArray[np.bool_]) -> float:
    """Counts above those of no exposure at which the signal has stopped to grow with the exposure; nan where it has not."""
    longer = pairs[-1].exposure_s / pairs[-2].exposure_s - 1
    if not signal[-1] / signal[-2] - 1 < _FLAT * longer:
        return math.nan
    flat, black = (frames[:, region].mean(dtype=np.float64) for frames in (pairs[-1].flat, pairs[0].dark))
    return float(flat - black)


def _read_variance(pairs: Sequence[FlatPair], region: NDArray[np.bool_]) -> float:
    """Temporal variance of the dark at no exposure, counts^2: that of dark current, which grows with the exposure, taken off."""
    time = np.array([pair.exposure_s for pair in pairs])
    variance = np.array([_difference_variance(pair.dark, region) for pair in pairs])
    level, slope = cast("list[float]", np.polynomial.polynomial.polyfit(time - time.mean(), variance, 1).tolist())
    return max(level - max(slope, 0.0) * float(time.mean()), 0.0)


def _gain(moments: Sequence[tuple[float, float]], pixels: int) -> tuple[float, float]:
    """Slope of the variance over the signal, through the origin, and its standard error."""
    if not moments:
        raise CalibrationError("no exposure lies below 70 % of saturation.", hint="shorter exposures too")
    x, y = np.array(moments).T
    weight = 1 / np.maximum(y, y.max() * 1e-3) ** 2  # a variance of n pixels is known to sqrt(2 / n) of itself
    gain = float(np.sum(weight * x * y) / np.sum(weight * x * x))
    if not gain > 0:
        raise CalibrationError(
            "the noise does not grow with the light: the frames are averaged, clipped or compressed."
        )
    return gain, math.sqrt(2 / pixels / float(np.sum(weight * x * x)))


def _spatial(frames: NDArray[Any], region: NDArray[np.bool_]) -> float:
    """Spatial standard deviation of the mean of two frames, temporal noise removed."""
    mean = frames[:, region].mean(axis=0, dtype=np.float64)
    return math.sqrt(max(float(np.var(mean)) - _difference_variance(frames, region) / 2, 0.0))


def _prnu(pairs: Sequence[FlatPair], signal: Floats, top: int, region: NDArray[np.bool_], light: Floats) -> float:
    """At half saturation, the spatial variance of flat less dark over the light, temporal noise removed, relative to its mean."""
    pair = pairs[int(np.argmin(np.abs(signal[: top + 1] - signal[top] / 2)))]
    even = light[region] / light[region].mean()
    first, second = (
        (flat - dark)[region] / even for flat, dark in zip(_floats(pair.flat), _floats(pair.dark), strict=True)
    )
    mean = (first + second) / 2
    variance = float(np.var(mean)) - float(np.var(first - second)) / 4
    return math.sqrt(max(variance, 0.0)) / float(mean.mean())


def _floats(frames: NDArray[Any]) -> Floats:
    return frames.astype(np.float64)


def _linearity_error(exposure_s: Floats, signal: Floats, top: int) -> float:
    """Mean relative deviation from the line that fits best in relative terms, between 5 and 95 % of saturation."""
    low, high = (share * signal[top] for share in _LINEAR_RANGE)
    used = (signal >= low) & (signal <= high)
    if used.sum() < 3:
        return float("nan")
    x, y = exposure_s[used], signal[used]
    fitted = _relative_line(x, y)
    return float(np.mean(np.abs(y - fitted) / fitted))


def _relative_line(x: Floats, y: Floats) -> Floats:
    """The line through y whose relative deviations are least, at x."""
    (level, slope), *_ = np.linalg.lstsq(np.stack((1 / y, x / y), axis=1), np.ones_like(y), rcond=None)
    return level + slope * x

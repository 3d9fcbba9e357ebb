"""Signal to noise, as the paper defines it and as everybody else does (Eqs. 16-20, figure 12).

The paper divides the mean of a reflectance by its variance, 10 log10(mu / sigma^2): dimensionless only because a reflectance is,
and larger than the usual 20 log10(mu / sigma) by -10 log10(mu). Both are given, so that figures can be compared with either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import special

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_PLACE = ("exposure", "band")


@dataclass(frozen=True, slots=True, eq=False)
class SignalToNoise:
    """Signal to noise of each band at each exposure, from repeated lines of an even target.

    Attributes:
        exposure_s: Exposures, (exposure,).
        snr_db: 20 log10(mean / standard deviation) over time, median over the samples, (exposure, band).
        snr_paper_db: Eq. 20 on the reflectance given, 10 log10(mean / variance), (exposure, band).
        spatial_db: 20 log10(mean / standard deviation) over the samples of a mean line: what unevenness leaves, (exposure, band).
        lines: Lines used of each exposure, (exposure,).
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "snr"

    exposure_s: Annotated[Floats, Stored("s", "exposures", ("exposure",))]
    snr_db: Annotated[Floats, Stored("dB", "temporal signal to noise", _PLACE)]
    snr_paper_db: Annotated[Floats, Stored("dB", "signal to noise by equation 20 of the paper", _PLACE)]
    spatial_db: Annotated[Floats, Stored("dB", "signal to noise over the samples", _PLACE)]
    lines: Annotated[NDArray[np.int64], Stored("1", "lines used", ("exposure",))]
    provenance: Provenance


def signal_to_noise(captures: dict[float, NDArray[Any]], provenance: Provenance) -> SignalToNoise:
    """Work out the signal to noise of reflectances, or of dark-corrected counts.

    Eq. 20 means something only for reflectances; of counts, ``snr_paper_db`` is nan.

    Args:
        captures: Exposure in s -> (band, line, sample) values of the same place, nan where not known.
        provenance: Where they come from.

    Raises:
        CalibrationError: Fewer than three lines at an exposure, sizes that differ, or neither light nor noise.
    """
    if not captures:
        raise CalibrationError("there is nothing to work a signal to noise ratio out from.")
    exposures = sorted(captures)
    shapes = {captures[exposure].shape[::2] for exposure in exposures}
    if len(shapes) > 1 or any(captures[exposure].ndim != 3 for exposure in exposures):
        raise CalibrationError("the captures have different bands or samples.")
    for exposure in exposures:
        if captures[exposure].shape[1] < 3:
            raise CalibrationError(f"{captures[exposure].shape[1]} lines at {exposure:g} s show no noise; take 20.")
    moments = {exposure: _moments(np.asarray(captures[exposure], np.float64)) for exposure in exposures}
    return signal_to_noise_of(moments, provenance)


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Repeated lines of an even target at one exposure, as their mean and noise.

    Attributes:
        mean, sigma: Reflectance or dark-corrected counts, and their standard deviation over the lines, (band, sample); nan where
            not known.
        lines: Lines they are of.
    """

    mean: Floats
    sigma: Floats
    lines: int


def signal_to_noise_of(moments: dict[float, Moments], provenance: Provenance) -> SignalToNoise:
    """The same from running moments, so that no capture has to be in memory.

    Args:
        moments: Exposure in s -> moments of the same place.
        provenance: Where they come from.

    Raises:
        CalibrationError: Nothing is given, fewer than three lines at an exposure, sizes that differ, or neither light nor noise.
    """
    exposures = sorted(moments)
    if not exposures or len({moments[exposure].mean.shape for exposure in exposures}) > 1:
        raise CalibrationError("a signal to noise ratio needs captures of the same bands and samples.")
    if few := [f"{exposure:g} s" for exposure in exposures if moments[exposure].lines < 3]:
        raise CalibrationError(f"fewer than three lines show no noise: at {', '.join(few)}; take 20.")
    columns = [_ratios(moments[exposure]) for exposure in exposures]
    snr, paper, spatial = (np.stack(column) for column in zip(*columns, strict=True))
    if not np.isfinite(snr).any():
        raise CalibrationError(
            "no band shows both light and noise.", hint="is it lit, and not saturated? were the frames averaged before?"
        )
    lines = np.array([moments[exposure].lines for exposure in exposures], np.int64)
    return SignalToNoise(np.array(exposures), snr, paper, spatial, lines, provenance)


def _moments(values: Floats) -> Moments:
    values = np.where(np.isfinite(values), values, np.nan)
    return Moments(values.mean(axis=1), values.std(axis=1, ddof=1), values.shape[1])


def _ratios(moments: Moments) -> tuple[Floats, Floats, Floats]:
    # Few lines tell a variance as a chi-square does, whose median lies below its mean: 0.16 dB with 20 lines.
    degrees = moments.lines - 1
    mean, sigma = moments.mean, moments.sigma * math.sqrt(degrees / float(special.chdtri(degrees, 0.5)))
    with np.errstate(divide="ignore", invalid="ignore"):
        temporal = 20 * np.log10(mean / sigma)
        paper = 10 * np.log10(mean / sigma**2)
        if np.nanmax(mean, initial=0) > _REFLECTANCE_AT_MOST:
            paper = np.full_like(paper, np.nan)
        spatial = np.array([_unevenness(row[np.isfinite(row)]) for row in mean])
    return _median(temporal), _median(paper), spatial


def _unevenness(row: Floats) -> float:
    return float(20 * np.log10(row.mean() / row.std(ddof=1))) if row.size > 2 else math.nan


def _median(values: Floats) -> Floats:
    """Median over the samples that are known, (band,); nan where none is."""
    return np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in values])


_REFLECTANCE_AT_MOST = 3.0
"""Means above this are counts, whatever they are called."""

"""Spatial resolution: contrast of bars (USAF 1951, figure 11) and the transfer function of a slanted edge (after ISO 12233).

Both take a picture of one band or the mean of some, (line, sample), and work along either axis: along the scan the jitter of the
mirror blurs, along the slit the optics alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Axis = Literal["line", "sample"]

_OVERSAMPLING = 4
_THRESHOLD = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class EdgeResponse:
    """Modulation transfer across a slanted edge.

    Attributes:
        axis: ``line`` along the scan, ``sample`` along the slit.
        frequency_per_mm: Spatial frequencies, (frequency,), up to the sampling's Nyquist frequency.
        mtf: Modulation transfer, 1 at frequency 0, (frequency,).
        mtf50_per_mm: Where it falls to one half; nan where it does not.
        mtf10_per_mm: Where it falls to a tenth; nan where it does not.
        angle_deg: Of the edge from the direction across the axis.
        pitch_mm: Distance of lines or samples.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "edge"

    axis: str
    frequency_per_mm: Annotated[Floats, Stored("mm-1", "spatial frequency", ("frequency",))]
    mtf: Annotated[Floats, Stored("1", "modulation transfer", ("frequency",))]
    mtf50_per_mm: Annotated[float, Stored("mm-1", "frequency of half the contrast")]
    mtf10_per_mm: Annotated[float, Stored("mm-1", "frequency of a tenth of the contrast")]
    angle_deg: Annotated[float, Stored("degree", "slant of the edge")]
    pitch_mm: Annotated[float, Stored("mm", "distance of the pixels")]
    provenance: Provenance


def edge_response(
    picture: NDArray[Any], axis: Axis, pitch_mm: float, provenance: Provenance, *, across_mm: float | None = None
) -> EdgeResponse:
    """Modulation transfer from a region that holds one slanted edge.

    The edge is found in every row, a line fitted through it, and all rows are put together along that line on a grid four times
    finer than the pixels; the spectrum of the derivative is the transfer function, corrected for the bins and the difference.

    Args:
        picture: (line, sample), bright on one side of the edge.
        axis: Along which the transfer is wanted: the edge runs roughly across it, slanted by 2 to 20 degrees.
        pitch_mm: Distance of the pixels along the axis.
        provenance: Where the picture comes from.
        across_mm: Distance of the pixels along the other axis, where it is another one: the slant is an angle on the target.

    Raises:
        CalibrationError: No edge, one that is not slanted, a region too small, or values that are no numbers.
    """
    rows = np.asarray(picture, np.float64)
    rows = rows.T if axis == "line" else rows
    if rows.ndim != 2 or rows.shape[0] < 20 or rows.shape[1] < 16:
        raise CalibrationError(
            f"an edge needs 20 rows of 16 pixels at least, not {rows.shape} across and along the {axis} axis."
        )
    if not np.isfinite(rows).all():
        raise CalibrationError("the edge holds pixels that are no numbers: saturated, or missing lines.")
    offset, slope = _edge(rows)
    if not math.tan(math.radians(1.5)) <= abs(slope) <= math.tan(math.radians(25)):
        raise CalibrationError(
            f"the edge is slanted by {math.degrees(math.atan(slope)):.1f} degrees; between 1.5 and 25 are needed.",
            hint="turn the target by some 5 degrees",
        )
    spread = _edge_spread(rows, offset, slope)
    angle = math.atan(slope * pitch_mm / (across_mm or pitch_mm))
    frequency, mtf = _transfer(spread, math.cos(angle))
    used = frequency <= 0.5
    frequency, mtf = frequency[used] / pitch_mm, mtf[used]
    return EdgeResponse(
        axis=axis,
        frequency_per_mm=frequency,
        mtf=mtf,
        mtf50_per_mm=_falls_to(0.5, frequency, mtf),
        mtf10_per_mm=_falls_to(0.1, frequency, mtf),
        angle_deg=math.degrees(angle),
        pitch_mm=pitch_mm,
        provenance=provenance,
    )


def _edge(rows: Floats) -> tuple[float, float]:
    """Place of the edge in row 0, and its change a row, in pixels: centroids of the derivative, then a line, twice."""
    gradient = np.abs(np.diff(rows, axis=1)) ** 2
    place: Floats = np.arange(0.5, gradient.shape[1], dtype=np.float64)
    window = np.ones_like(gradient)
    index = np.arange(len(rows), dtype=np.float64)
    offset = slope = 0.0
    for _ in range(3):
        weight = gradient * window
        total = weight.sum(axis=1)
        if not (total > 0).all():
            raise CalibrationError("there is no edge in some of the rows.")
        centre = (weight * place).sum(axis=1) / total
        design = np.stack((index, np.ones_like(index)), axis=1)
        slope, offset = cast("list[float]", np.linalg.lstsq(design, centre, rcond=None)[0].tolist())
        reach = max(4.0, 0.15 * rows.shape[1])
        window = np.exp(-0.5 * ((place - (offset + slope * index)[:, None]) / reach) ** 2)
    swing = np.abs(rows[:, : rows.shape[1] // 8].mean() - rows[:, -rows.shape[1] // 8 :].mean())
    if swing < 4 * float(np.median(np.abs(np.diff(rows, axis=0)))):
        raise CalibrationError("no edge stands out of the noise.")
    return offset, slope


def _edge_spread(rows: Floats, offset: float, slope: float) -> Floats:
    """Mean over all rows on a grid of quarter pixels, moved so that the edge is in the middle."""
    index = np.arange(len(rows), dtype=np.float64)[:, None]
    across: Floats = np.arange(rows.shape[1], dtype=np.float64)[None, :] - (offset + slope * index)
    reach = rows.shape[1] // 2 - 2
    bins = np.floor((across + reach) * _OVERSAMPLING).astype(np.intp)
    size = 2 * reach * _OVERSAMPLING
    inside = (bins >= 0) & (bins < size)
    total = np.bincount(bins[inside], rows[inside], size)
    count = np.bincount(bins[inside], minlength=size)
    known = count > 0
    if known.mean() < 0.9:
        raise CalibrationError("the edge fills its bins badly: more rows, or another slant, are needed.")
    place = np.arange(size, dtype=np.float64)
    return np.interp(place, place[known], total[known] / count[known])


def _transfer(spread: Floats, cosine: float) -> tuple[Floats, Floats]:
    """Frequencies in cycles a pixel along the axis, and the transfer."""
    line_spread = np.diff(spread)
    line_spread *= np.hanning(len(line_spread))
    spectrum = np.abs(np.fft.rfft(line_spread))
    frequency = np.arange(len(spectrum), dtype=np.float64) * (_OVERSAMPLING / len(line_spread))
    fine = (
        frequency / _OVERSAMPLING
    )  # cycles a bin: the mean over a bin, and the difference of two, each damp by a sinc
    mtf: Floats = spectrum / spectrum[0] / np.sinc(fine) ** 2
    return frequency / cosine, mtf


def _falls_to(level: float, frequency: Floats, mtf: Floats) -> float:
    below = np.flatnonzero(mtf < level)
    if not below.size or below[0] == 0:
        return math.nan
    right = int(below[0])
    share = (mtf[right - 1] - level) / (mtf[right - 1] - mtf[right])
    return float(frequency[right - 1] + share * (frequency[right] - frequency[right - 1]))


@dataclass(frozen=True, slots=True, eq=False)
class BarContrast:
    """Contrast of three-bar elements along one axis.

    Attributes:
        axis: ``line`` along the scan, ``sample`` along the slit.
        bar_mm: Widths of a bar, widest first, (element,).
        contrast: Michelson contrast of each, relative to that of large areas, (element,).
        resolved_mm: Narrowest bar such that it and all wider ones show the threshold's contrast; nan where not even the widest.
        threshold: Contrast asked for.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "bars"

    axis: str
    bar_mm: Annotated[Floats, Stored("mm", "width of a bar", ("element",))]
    contrast: Annotated[Floats, Stored("1", "Michelson contrast", ("element",))]
    resolved_mm: Annotated[float, Stored("mm", "narrowest bar resolved")]
    threshold: Annotated[float, Stored("1", "contrast asked for")]
    provenance: Provenance


def bar_contrast(
    elements: Sequence[tuple[float, NDArray[Any]]],
    axis: Axis,
    pitch_mm: float,
    provenance: Provenance,
    *,
    black: float = 0.0,
    white: float | None = None,
    threshold: float = _THRESHOLD,
) -> BarContrast:
    """Contrast of elements of three bars.

    At the frequency of the bars the profile is fitted with a sine: noise and sloping light do not count as contrast, as they
    would in a difference of the brightest and the darkest pixel.

    Args:
        elements: Width of a bar in mm, and the part of the picture that holds the three bars and little else, (line, sample).
        axis: Along which the bars follow each other.
        pitch_mm: Distance of the pixels along the axis.
        provenance: Where the picture comes from.
        black: Level of large black areas.
        white: Level of large white areas; the brightest mean of the elements by default.
        threshold: Contrast that counts as resolved.

    Raises:
        CalibrationError: No elements, one smaller than two periods, values that are no numbers, or nothing that varies.
    """
    if not elements:
        raise CalibrationError("there are no elements of bars.")
    ordered = sorted(elements, key=lambda element: -element[0])
    profiles = [(width, _profile(part, axis, width, pitch_mm)) for width, part in ordered]
    if all(np.ptp(profile) == 0 for _, profile in profiles):
        raise CalibrationError("nothing varies over the bars: saturated, or no light.")
    top = white if white is not None else max(float(profile.max()) for _, profile in profiles)
    if not top > black:
        raise CalibrationError(f"white ({top:g}) is not brighter than black ({black:g}).")
    full = (top - black) / (top + black)
    contrast = np.array([_sine_contrast(profile, pitch_mm / (2 * width)) / full for width, profile in profiles])
    good = np.flatnonzero(np.cumprod(contrast >= threshold))
    widths = np.array([width for width, _ in profiles])
    return BarContrast(
        axis=axis,
        bar_mm=widths,
        contrast=contrast,
        resolved_mm=float(widths[good[-1]]) if good.size else math.nan,
        threshold=threshold,
        provenance=provenance,
    )


def _profile(part: NDArray[Any], axis: Axis, width_mm: float, pitch_mm: float) -> Floats:
    values = np.asarray(part, np.float64)
    if values.ndim != 2 or not values.size or not np.isfinite(values).all():
        raise CalibrationError(f"the element of {width_mm:g} mm bars has pixels that are no numbers, or none.")
    profile = values.mean(axis=1 if axis == "line" else 0)
    if len(profile) * pitch_mm < 4 * width_mm or 2 * width_mm < 2 * pitch_mm:
        raise CalibrationError(
            f"bars of {width_mm:g} mm cannot be told in {len(profile)} pixels of {pitch_mm:g} mm: two periods, of two pixels each, "
            "are the least."
        )
    return profile


def _sine_contrast(profile: Floats, frequency: float) -> float:
    """Contrast of the square wave whose first harmonic fits the profile: (4 / pi) more than that of the sine."""
    place = np.arange(len(profile), dtype=np.float64)
    angle = 2 * np.pi * frequency * place
    design = np.stack((np.ones_like(place), place - place.mean(), np.cos(angle), np.sin(angle)), axis=1)
    level, _, cosine, sine = np.linalg.lstsq(design, profile, rcond=None)[0].tolist()
    return math.hypot(cosine, sine) * math.pi / 4 / max(abs(level), 1e-12)

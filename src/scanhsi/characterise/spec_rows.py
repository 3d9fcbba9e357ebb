"""Rows of the specification sheet, from each kind of result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Final

import numpy as np

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.resolution import BarContrast, EdgeResponse
from scanhsi.calibration.result import Result
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.calibration.white import WhiteReference

_AXES: Final = {"line": "along the scan", "sample": "along the slit"}
_MEDIAN_OF_NORMAL: Final = 0.674  # of the magnitude of a normal number


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    Attributes:
        key: Names it in ``spec.json``.
        title: In words.
        value: With its unit.
        uncertainty: One standard error, with its unit; empty where none is known.
        number: The value as a number, for programs; None where it is none.
        unit: Of ``number``.
        source: File of the result, or what else it comes from; empty where nothing was measured.
        taken: When it was measured, ISO 8601.
        simulated: Whether it is of a simulated instrument; None where that is not known.
        paper: What the paper's table says of its instrument.
    """

    key: str
    title: str
    value: str
    uncertainty: str = ""
    number: float | None = None
    unit: str = ""
    source: str = ""
    taken: str = ""
    simulated: bool | None = None
    paper: str = ""


@dataclass(frozen=True, slots=True)
class Timing:
    """Efficiency in one mode, from the records of the bench.

    Attributes:
        mode, pixel_format, exposure_s: Of the scan.
        efficiency, sigma: Exposure over line period, with its standard error.
        lines: Line periods measured.
        source: File of the records.
        taken: When, ISO 8601.
        simulated: Whether the instrument was.
    """

    mode: str
    pixel_format: str
    exposure_s: float
    efficiency: float
    sigma: float
    lines: int
    source: str
    taken: str
    simulated: bool


Make = Callable[..., Row]


def result_rows(result: Result, source: str) -> list[Row]:
    """Rows of a result.

    Args:
        result: Of any kind; one that the sheet has no row for gives none.
        source: Its file.
    """
    provenance = result.provenance

    def make(key: str, title: str, number: float, unit: str, sigma: float = math.nan, text: str = "") -> Row:
        return Row(
            key,
            title,
            text or _shown(number, unit, sigma),
            uncertainty=_shown(sigma, unit, sigma) if math.isfinite(sigma) else "",
            number=number if math.isfinite(number) else None,
            unit=unit,
            source=source,
            taken=provenance.taken or provenance.created,
            simulated=provenance.simulated,
        )

    return _rows(result, make)


@singledispatch
def _rows(result: object, make: Make) -> list[Row]:
    del result, make
    return []


@_rows.register
def _(result: DarkModel, make: Make) -> list[Row]:
    good = ~(result.hot | result.nonlinear)
    count = math.sqrt(good.sum())
    rate, offset = result.rate[good], result.offset[good]
    return [
        make("dark current", "Dark current, mean", float(rate.mean()), "counts/s", float(rate.std()) / count),
        make("dark offset", "Dark offset, mean", float(offset.mean()), "counts", float(offset.std()) / count),
        make("hot pixels", "Hot pixels", float(result.hot.mean()), "", text=_part(result.hot)),
        make(
            "nonlinear pixels",
            "Pixels not linear in the dark",
            float(result.nonlinear.mean()),
            "",
            text=_part(result.nonlinear),
        ),
    ]


@_rows.register
def _(result: WhiteReference, make: Make) -> list[Row]:
    signal = result.mean - result.dark
    known = np.isfinite(signal) & (signal > 0)
    error = float(np.median(result.sigma[known] / signal[known])) if known.any() else math.nan
    return [make("white", "White reference, standard error of a pixel", 100 * error, "%")]


@_rows.register
def _(result: PhotonTransfer, make: Make) -> list[Row]:
    return [
        make("system gain", "System gain", result.gain, "counts/e", result.gain_sigma),
        make("read noise", "Read noise", result.read_noise_e, "e"),
        make("full well", "Full well", result.full_well_e, "e"),
        make("saturation", "Saturation capacity, at the largest variance", result.saturation_e, "e"),
        make("sensor snr", "Signal to noise at saturation", result.snr_max_db, "dB"),
        make("dynamic range", "Dynamic range", result.dynamic_range_db, "dB"),
        make("dsnu", "Dark signal non-uniformity", result.dsnu_e, "e"),
        make("prnu", "Photo response non-uniformity", 100 * result.prnu, "%"),
        make(
            "linearity",
            "Linearity error",
            100 * result.linearity_error,
            "%",
            text=f"{100 * result.linearity_error:.2g} %",
        ),
    ]


@_rows.register
def _(result: SignalToNoise, make: Make) -> list[Row]:
    if not np.isfinite(result.snr_db).any():
        return []
    exposure, band = np.unravel_index(np.nanargmax(result.snr_db), result.snr_db.shape)
    best = float(result.snr_db[exposure, band])
    seconds = float(result.exposure_s[exposure])
    frames = int(result.lines[exposure])
    sigma = 20 / math.log(10) / math.sqrt(2 * (frames - 1))  # of one pixel: the median of many is better known
    text = f"up to {best:.1f} dB (band {int(band)}, {1000 * seconds:g} ms); median of the bands "
    text += f"{float(np.nanmedian(result.snr_db[exposure])):.1f} dB"
    return [make("snr", "", best, "dB", sigma, text)]


@_rows.register
def _(result: Wavelength, make: Make) -> list[Row]:
    ends = result.nm(np.array([0, result.bands - 1]))
    errors = result.sigma_nm(np.array([0, result.bands - 1]))
    middle = float(ends.mean())
    width = float(result.fwhm_nm(middle))
    known = np.isfinite(result.line_fwhm_nm)
    sigma = math.nan
    if known.sum() > 1:
        sigma = float(np.std(result.line_fwhm_nm[known], ddof=1)) / math.sqrt(int(known.sum()))
    text = f"{width:.2f} nm FWHM at {middle:.0f} nm; {float(np.ptp(ends)) / (result.bands - 1):.3f} nm a band"
    return [
        make("wavelength range", "", math.nan, "nm", float(errors.max()), f"{ends.min():.1f}-{ends.max():.1f} nm"),
        make("spectral resolution", "", width, "nm", sigma, text),
        make("wavelength residual", "Lines around the wavelength polynomial", result.residual_nm, "nm"),
    ]


@_rows.register
def _(result: LightStability, make: Make) -> list[Row]:
    return [
        make("lamp settling", "Lamp, time constant of settling", result.settling_s, "s", result.settling_sigma_s),
        make("lamp stable", "Lamp, within 1 % after", result.stable_after_s, "s"),
        make("lamp drift", "Lamp, drift a minute", 100 * result.drift_per_min, "%"),
    ]


@_rows.register
def _(result: Geometry, make: Make) -> list[Row]:
    linear = result.linear_range()
    turn = linear.steps * abs(result.step_rad) * 2
    rows = [
        make("distance", "Mirror to object plane", result.distance_mm, "mm", result.distance_sigma_mm),
        make("normal step", "Step normal to the plane", result.normal_step, "steps", result.normal_sigma_steps),
        make(
            "rotation",
            "",
            turn,
            "rad",
            text=f"{turn:.4f} rad ({math.degrees(turn):.1f} deg, {2 * linear.steps:.0f} steps) for even lines",
        ),
    ]
    roi = result.provenance.conditions.roi
    if roi is not None and "samples" in roi:
        wide, long = roi["samples"] * result.sample_pitch_mm, 2 * linear.y_mm
        lines = int(2 * linear.steps) + 1
        rows += [
            make("field of view", "", wide, "mm", text=f"{wide:.0f} x {long:.0f} mm at {result.distance_mm:.0f} mm"),
            make("resolution", "", float(roi["samples"] * lines), "px", text=f"{roi['samples']} x {lines} pixels"),
        ]
    return rows


@_rows.register
def _(result: Jitter, make: Make) -> list[Row]:
    slope = 0.1 / (_MEDIAN_OF_NORMAL * result.sigma_mm) if result.sigma_mm > 0 else math.nan
    text = f"10 % of a pixel where the intensity changes by {slope:.2f} of itself a mm" if slope == slope else ""
    return [
        make("jitter", "Jitter of the mirror, standard deviation", result.sigma_mm, "mm", result.sigma_error_mm),
        make("microstepping", "", slope, "1/mm", slope * result.sigma_error_mm / result.sigma_mm, text),
    ]


@_rows.register
def _(result: EdgeResponse, make: Make) -> list[Row]:
    where = _AXES.get(result.axis, result.axis)
    return [
        make(f"mtf50 {result.axis}", f"Half contrast (MTF50) {where}", result.mtf50_per_mm, "1/mm"),
        make(f"mtf10 {result.axis}", f"A tenth of contrast (MTF10) {where}", result.mtf10_per_mm, "1/mm"),
    ]


@_rows.register
def _(result: BarContrast, make: Make) -> list[Row]:
    where = _AXES.get(result.axis, result.axis)
    return [make(f"usaf {result.axis}", f"USAF 1951, best resolved bar {where}", result.resolved_mm, "mm")]


def timing_rows(timings: Sequence[Timing]) -> list[Row]:
    """Rows of efficiencies; Table 7 has that of 8 bit and 100 ms in the mode of the paper, everything in turn."""
    rows: list[Row] = []
    for timing in timings:
        said = f"{timing.pixel_format}, {1000 * timing.exposure_s:g} ms"
        papers = timing.pixel_format == "Mono8" and math.isclose(timing.exposure_s, 0.1)
        key = "efficiency" if papers and timing.mode == "sequential" else f"efficiency {timing.mode} {said}"
        rows.append(
            Row(
                key,
                f"Efficiency, {timing.mode}, {said}",
                f"{100 * timing.efficiency:.1f} %",
                uncertainty=f"{100 * timing.sigma:.1g} %",
                number=timing.efficiency,
                unit="1",
                source=timing.source,
                taken=timing.taken,
                simulated=timing.simulated,
            )
        )
    return rows


def _shown(number: float, unit: str, sigma: float) -> str:
    """A number with as many digits as its uncertainty deserves, four without one."""
    if not math.isfinite(number):
        return "not found"
    if math.isfinite(sigma) and sigma > 0:
        digits = max(0, 1 - math.floor(math.log10(sigma)))
        return f"{number:.{min(digits, 9)}f} {unit}".strip()
    return f"{number:.0f} {unit}".strip() if abs(number) >= 1000 else f"{number:.4g} {unit}".strip()


def _part(flags: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> str:
    return f"{int(flags.sum())} of {flags.size} ({100 * float(flags.mean()):.3g} %)"

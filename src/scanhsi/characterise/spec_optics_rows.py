"""Rows of spectrograph, object plane and sharpness."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.resolution import BarContrast, EdgeResponse
from scanhsi.calibration.smile import Smile
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.characterise.spec_row import Make, Row

_AXES: Final = {"line": "along the scan", "sample": "along the slit"}


def _wavelength(result: Wavelength, make: Make) -> list[Row]:
    if not np.isfinite(result.line_fwhm_nm).any():
        return _wavelength_tile(result, make)
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


def _wavelength_tile(result: Wavelength, make: Make) -> list[Row]:
    """Of a tile, whose wide bands tell nothing of the resolution."""
    ends = result.nm(np.array([0, result.bands - 1]))
    sigma = float(result.sigma_nm(np.array([0, result.bands - 1])).max())
    text = f"{ends.min():.1f}-{ends.max():.1f} nm"
    return [
        make("wavelength range tile", "Wavelength range by the absorption tile", math.nan, "nm", sigma, text),
        make("tile residual", "Minima around the wavelength polynomial", result.residual_nm, "nm"),
    ]


def _smile(result: Smile, make: Make) -> list[Row]:
    widths = result.line_fwhm_nm[np.isfinite(result.line_fwhm_nm)]
    low, high = (float(np.quantile(widths, share)) for share in (0.05, 0.95))
    return [
        make("smile", "Smile, largest", result.largest_bands, "bands", _error(result.coefficients_sigma)),
        make(
            "resolution over slit",
            "Width of spectral lines over slit and spectrum (5-95 %)",
            float(np.median(widths)),
            "nm",
            text=f"{low:.2f}-{high:.2f} nm",
        ),
    ]


def _keystone(result: Keystone, make: Make) -> list[Row]:
    sigma = _error(result.coefficients_sigma)
    return [make("keystone", "Keystone, largest", result.largest_samples, "samples", sigma)]


def _error(sigma: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """Of a sum of terms that are 1 at most."""
    return math.sqrt(float(np.nansum(sigma**2)))


def _geometry(result: Geometry, make: Make) -> list[Row]:
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
        sigma = long * result.distance_sigma_mm / result.distance_mm  # of the length of the scan
        lines = int(2 * linear.steps) + 1
        rows += [
            make("field of view", "", wide, "mm", sigma, f"{wide:.0f} x {long:.0f} mm at {result.distance_mm:.0f} mm"),
            make("resolution", "", float(roi["samples"] * lines), "px", text=f"{roi['samples']} x {lines} pixels"),
        ]
    return rows


def _edge(result: EdgeResponse, make: Make) -> list[Row]:
    where = _AXES.get(result.axis, result.axis)
    return [
        make(f"mtf50 {result.axis}", f"Half contrast (MTF50) {where}", result.mtf50_per_mm, "1/mm"),
        make(f"mtf10 {result.axis}", f"A tenth of contrast (MTF10) {where}", result.mtf10_per_mm, "1/mm"),
    ]


def _bars(result: BarContrast, make: Make) -> list[Row]:
    where = _AXES.get(result.axis, result.axis)
    return [make(f"usaf {result.axis}", f"USAF 1951, best resolved bar {where}", result.resolved_mm, "mm")]


ROWS: Final[dict[str, Callable[[Any, Make], list[Row]]]] = {
    Wavelength.kind: _wavelength,
    Smile.kind: _smile,
    Keystone.kind: _keystone,
    Geometry.kind: _geometry,
    EdgeResponse.kind: _edge,
    BarContrast.kind: _bars,
}
"""Kind of a result -> its rows."""

"""Figures of mirror and optics: wavelengths, geometry, jitter, transfer functions, bars."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from scanhsi.calibration.figures.style import BLUE, GREY, ORANGE, RED, sheet
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.resolution import BarContrast, EdgeResponse
from scanhsi.calibration.wavelength import Wavelength

_AXES: Final = {"line": "along the scan", "sample": "along the slit"}


def draw_geometry(result: Geometry) -> Figure:
    """Where the steps look at, and how the distance of lines grows (figures 4 and 7)."""
    figure = sheet("Object plane", result.provenance)
    left, right = figure.subplots(1, 2)
    linear = result.linear_range()
    steps = np.linspace(result.normal_step - 1.4 * linear.steps, result.normal_step + 1.4 * linear.steps, 400)
    left.plot(steps, result.y_mm(steps), color=BLUE, label="where the step looks at")
    slope = float(result.y_mm(result.normal_step + 1) - result.y_mm(result.normal_step))
    left.plot(steps, slope * (steps - result.normal_step), color=GREY, linestyle=":", label="evenly spaced lines")
    left.set_xlabel("mirror step")
    left.set_ylabel("y / mm")
    left.set_title(
        f"distance {result.distance_mm:.2f} $\\pm$ {result.distance_sigma_mm:.2f} mm, {result.points} points"
    )
    left.legend()
    right.plot(steps, result.line_pitch_mm(steps), color=BLUE, label="line pitch")
    right.plot(steps, result.x_mm(result.principal_sample + 1, steps), color=ORANGE, label="sample pitch")
    right.set_xlabel("mirror step")
    right.set_ylabel("pitch / mm")
    right.set_ylim(bottom=0)
    for axes in (left, right):
        axes.axvspan(
            result.normal_step - linear.steps,
            result.normal_step + linear.steps,
            color="0.9",
            zorder=0,
            label="linear range",
        )
    right.legend(loc="lower center")
    return figure


def draw_jitter(result: Jitter) -> Figure:
    """Residuals line by line, their distribution and their spectrum (figure 8)."""
    figure = sheet("Jitter of the mirror", result.provenance)
    left, middle, right = figure.subplots(1, 3)
    residual = result.residual_mm
    left.plot(residual, ".", color=BLUE, markersize=3)
    left.set_xlabel("line")
    left.set_ylabel("displacement / mm")
    if np.isfinite(result.turn_steps):
        left.set_title(
            f"less a turn of {result.turn_steps:.0f} steps, $\\pm$ {result.misalignment_mm:.2f} mm", fontsize=7.5
        )
    count = max(8, min(40, len(residual) // 8))
    middle.hist(residual, count, density=True, color=BLUE)
    place = np.linspace(-4 * result.sigma_mm, 4 * result.sigma_mm, 200)
    normal = np.exp(-(place**2) / (2 * result.sigma_mm**2)) / (result.sigma_mm * np.sqrt(2 * np.pi))
    middle.plot(place, normal, color=ORANGE)
    middle.set_xlabel("displacement / mm")
    middle.set_ylabel("density / mm$^{-1}$")
    middle.set_title(f"$\\sigma$ = {result.sigma_mm:.3f} $\\pm$ {result.sigma_error_mm:.3f} mm")
    power = np.abs(np.fft.rfft(residual - residual.mean()))[1:] ** 2 / len(residual)
    frequency = np.fft.rfftfreq(len(residual))[1:]
    right.semilogy(frequency, power, color=BLUE, linewidth=0.8)
    right.axhline(float(result.sigma_mm**2), color=ORANGE, linestyle=":", label="white noise of this size")
    right.set_xlabel("frequency / cycles per line")
    right.set_ylabel("power / mm$^2$")
    right.legend()
    return figure


def draw_edge(result: EdgeResponse) -> Figure:
    """Modulation transfer across a slanted edge."""
    figure = sheet(f"Modulation transfer {_AXES.get(result.axis, result.axis)}", result.provenance)
    axes = figure.subplots()
    axes.plot(result.frequency_per_mm, result.mtf, color=BLUE)
    for frequency, level, colour in ((result.mtf50_per_mm, 0.5, ORANGE), (result.mtf10_per_mm, 0.1, RED)):
        if np.isfinite(frequency):
            axes.plot([0, frequency, frequency], [level, level, 0], color=colour, linestyle=":")
            axes.annotate(f"{frequency:.2f} / mm", (frequency, level), (4, 4), textcoords="offset points", color=colour)
    axes.set_xlabel("spatial frequency / mm$^{-1}$")
    axes.set_ylabel("modulation transfer")
    axes.set_ylim(0, 1.05)
    axes.set_xlim(0, float(result.frequency_per_mm[-1]))
    return figure


def draw_bars(result: BarContrast) -> Figure:
    """Contrast of the bars of the USAF target over their width (figure 11)."""
    figure = sheet(f"USAF 1951 bars {_AXES.get(result.axis, result.axis)}", result.provenance)
    axes = figure.subplots()
    axes.semilogx(result.bar_mm, result.contrast, "o-", color=BLUE)
    axes.axhline(result.threshold, color=GREY, linestyle=":", label=f"contrast {result.threshold:g}: resolved")
    if np.isfinite(result.resolved_mm):
        axes.axvline(result.resolved_mm, color=ORANGE, label=f"best resolved: {result.resolved_mm:.3g} mm")
    ticks = [tick for tick in (0.1, 0.2, 0.3, 0.5, 1, 2, 3, 5) if result.bar_mm.min() <= tick <= result.bar_mm.max()]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("width of a bar / mm")
    axes.set_ylabel("contrast")
    axes.set_ylim(bottom=0)
    axes.legend()
    return figure


def draw_wavelength(result: Wavelength) -> Figure:
    """Wavelength of the bands, what the lines leave, and the width of the lines (figures 9 and 10)."""
    figure = sheet(f"Wavelengths, {Path(result.source).name}", result.provenance)
    shows_width = bool(np.isfinite(result.line_fwhm_nm).any())  # the bands of a tile are wide by themselves
    axes = figure.subplots(1, 2 + shows_width)
    left, middle = axes[:2]
    left.plot(np.arange(result.bands), result.nm(), color=BLUE, linewidth=1)
    left.plot(result.line_band, result.line_nm, "o", color=ORANGE, markersize=3)
    left.set_xlabel("band")
    left.set_ylabel("wavelength / nm")
    rest = result.line_nm - result.nm(result.line_band)
    slope = np.abs(np.gradient(result.nm())[0])
    middle.errorbar(
        result.line_nm, 1000 * rest, yerr=1000 * slope * result.line_band_sigma, fmt="o", color=BLUE, markersize=3
    )
    middle.axhline(0, color=GREY, linewidth=0.8)
    middle.set_xlabel("wavelength / nm")
    middle.set_ylabel("line less polynomial / pm")
    if not shows_width:
        return figure
    right = axes[2]
    right.errorbar(
        result.line_nm, result.line_fwhm_nm, yerr=result.line_fwhm_sigma_nm, fmt="o", color=BLUE, markersize=3
    )
    nm = np.linspace(float(result.line_nm.min()), float(result.line_nm.max()), 50)
    right.plot(nm, result.fwhm_nm(nm), color=ORANGE, linewidth=1)
    right.set_xlabel("wavelength / nm")
    right.set_ylabel("width of a line (FWHM) / nm")
    return figure


FIGURES: Final[dict[str, Callable[[Any], Figure]]] = {
    Wavelength.kind: draw_wavelength,
    Geometry.kind: draw_geometry,
    Jitter.kind: draw_jitter,
    EdgeResponse.kind: draw_edge,
    BarContrast.kind: draw_bars,
}

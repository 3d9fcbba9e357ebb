"""Figures of the sensor and the light: dark, white, photon transfer, signal to noise, stability."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.figures.style import BLUE, GREEN, GREY, ORANGE, RED, sheet
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.white import WhiteReference

Floats = NDArray[np.float64]

_COLOURS: Final = (BLUE, ORANGE, GREEN, "#8E6BBF", "#E69F00", "#333333", "#56B4E9", RED)


def draw_dark(result: DarkModel) -> Figure:
    """How dark current and offset are distributed, and the dark signal over the exposure (Eq. 15)."""
    figure = sheet("Dark signal", result.provenance)
    left, middle, right = figure.subplots(1, 3)
    _distribution(left, result.rate, result.hot, "dark current / counts s$^{-1}$")
    left.set_ylabel("pixels")
    left.legend(loc="upper right", fontsize=6.5)
    _headroom(left)
    _distribution(middle, result.offset, result.hot, "offset / counts")
    seconds = np.linspace(0, result.longest_s, 50)
    good = ~result.hot
    for share, style in ((0.5, "-"), (0.01, ":"), (0.99, ":")):
        rate = float(np.quantile(result.rate[good], share))
        offset = float(np.median(result.offset[good]))
        label = "median pixel" if share == 0.5 else "1 and 99 % of the pixels" if share == 0.99 else None
        right.plot(seconds, rate * seconds + offset, style, color=BLUE, label=label)
    right.set_xlabel("exposure / s")
    right.set_ylabel("dark signal / counts")
    right.legend(loc="upper left")
    hot, odd = int(result.hot.sum()), int(result.nonlinear.sum())
    right.set_title(f"{hot} hot, {odd} nonlinear pixels", fontsize=7.5)
    return figure


def _distribution(axes: Axes, values: Floats, hot: NDArray[np.bool_], label: str) -> None:
    good = values[~hot]
    low, high = (float(np.quantile(good, share)) for share in (0.0005, 0.9995))
    spare = max(0.15 * (high - low), 1e-9)
    bins: Floats = np.linspace(low - spare, high + spare, 60)
    axes.hist(np.clip(good, bins[0], bins[-1]), bins.tolist(), color=BLUE, label="pixels")
    if hot.any():
        axes.hist(np.clip(values[hot], bins[0], bins[-1]), bins.tolist(), color=RED, label="hot, at the edge if beyond")
    axes.set_yscale("log")
    axes.set_xlabel(label)


def _headroom(axes: Axes) -> None:
    """Room for a legend above."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * (high / low) ** 0.25 if axes.get_yscale() == "log" else high + 0.25 * (high - low))


def draw_white(result: WhiteReference) -> Figure:
    """The white reference over sensor and spectrum."""
    figure = sheet("White reference", result.provenance)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    signal = result.mean - result.dark
    image = left.imshow(np.where(result.saturated, np.nan, signal), aspect="auto", origin="lower")
    image.cmap.set_bad(RED)
    left.grid(visible=False)
    left.set_xlabel("sample")
    left.set_ylabel("band")
    left.set_title(f"{int(result.saturated.sum())} saturated pixels" + (" (red)" if result.saturated.any() else ""))
    figure.colorbar(image, ax=left, label="white less dark / counts")
    samples = signal.shape[1]
    for place, colour, name in (
        (samples // 20, ORANGE, "one end of the slit"),
        (samples // 2, BLUE, "middle"),
        (samples - 1 - samples // 20, GREEN, "other end"),
    ):
        columns = signal[:, max(0, place - 2) : place + 3]
        right.plot(_row_means(columns), np.arange(len(signal)), color=colour, label=name)
    right.set_ylabel("band")
    right.set_xlabel("white less dark / counts")
    right.legend()
    return figure


def _row_means(values: Floats) -> Floats:
    return np.array([row[np.isfinite(row)].mean() if np.isfinite(row).any() else np.nan for row in values])


def draw_photon_transfer(result: PhotonTransfer) -> Figure:
    """Variance over signal, and signal over exposure."""
    figure = sheet("Photon transfer", result.provenance)
    left, right = figure.subplots(1, 2)
    top = int(np.argmax(result.variance))
    ramp: Floats = np.linspace(0, float(result.signal[top]), 2)
    left.plot(ramp, result.gain * ramp, color=GREY, linewidth=1, label=f"gain {result.gain:.4f} counts/electron")
    left.plot(result.signal[: top + 1], result.variance[: top + 1], "o", color=BLUE, label="measured")
    left.plot(result.signal[top + 1 :], result.variance[top + 1 :], "o", color=RED, mfc="white", label="saturated")
    left.set_xlabel("dark-corrected mean / counts")
    left.set_ylabel("temporal variance / counts$^2$")
    left.legend(loc="upper left")
    exposure_ms = 1000 * result.exposure_s
    used = slice(0, top + 1)
    slope = float(np.sum(result.signal[used] * exposure_ms[used]) / np.sum(exposure_ms[used] ** 2))
    right.plot(exposure_ms, slope * exposure_ms, color=GREY, linewidth=1, label="in proportion to the exposure")
    right.plot(exposure_ms[used], result.signal[used], "o", color=BLUE)
    right.plot(exposure_ms[top + 1 :], result.signal[top + 1 :], "o", color=RED, mfc="white")
    right.set_xlabel("exposure / ms")
    right.set_ylabel("dark-corrected mean / counts")
    known = np.isfinite(result.full_well_e)
    full = f"full well {result.full_well_e:.0f} e" if known else f"saturation {result.saturation_e:.0f} e"
    right.set_title(f"{full}, read noise {result.read_noise_e:.1f} e")
    right.legend(loc="upper left")
    return figure


def draw_snr(result: SignalToNoise) -> Figure:
    """Signal to noise by band and exposure, as everybody and as the paper defines it (figure 12, left)."""
    figure = sheet("Signal to noise of the white tile", result.provenance)
    left, right = figure.subplots(1, 2, sharey=True)
    colours = figure_colours(len(result.exposure_s))
    for axes, values in ((left, result.snr_db), (right, result.snr_paper_db)):
        for exposure, row, colour in zip(result.exposure_s, values, colours, strict=True):
            axes.plot(row, color=colour, label=f"{1000 * exposure:.3g} ms", linewidth=1)
        axes.set_xlabel("band")
    left.set_ylabel("signal to noise / dB")
    left.set_title(r"20 log$_{10}$($\mu$ / $\sigma$)")
    right.set_title(r"as the paper, 10 log$_{10}$($\mu$ / $\sigma^2$)")
    low, high = left.get_ylim()
    left.set_ylim(low - 0.25 * (high - low), high)
    right.legend(title="exposure", fontsize=7, ncols=3, loc="lower center")
    return figure


def figure_colours(count: int) -> list[str]:
    """So many colours."""
    return [_COLOURS[number % len(_COLOURS)] for number in range(count)]


def draw_light(result: LightStability) -> Figure:
    """The lamp over time (figure 12, right), and over which time averaging helps."""
    figure = sheet("Stability of the light", result.provenance)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1))
    show_lamp(left, result)
    right.loglog(result.averaging_s, 100 * result.allan, "o-", color=BLUE)
    right.set_xlabel("averaging time / s")
    right.set_ylabel("Allan deviation / %")
    right.grid(which="minor", visible=False)
    return figure


def show_lamp(axes: Axes, result: LightStability) -> None:
    """Level of the lamp over time, with the settling fitted to it."""
    axes.plot(result.time_s, 100 * (result.signal / result.level - 1), "o", color=BLUE, label="snapshots")
    if np.isfinite(result.settling_s):
        seconds: Floats = np.linspace(float(result.time_s[0]), float(result.time_s[-1]), 300)
        drift = result.drift_per_min / 60 * seconds
        curve = 100 * (result.overshoot * np.exp(-seconds / result.settling_s) + drift)
        text = f"settles in {result.settling_s:.0f} $\\pm$ {result.settling_sigma_s:.0f} s"
        axes.plot(seconds, curve, color=ORANGE, label=text)
        if result.stable_after_s > float(result.time_s[0]):
            axes.axvline(result.stable_after_s, color=GREY, linestyle=":", label="within 1 %")
    axes.set_xlabel("time since the lamp was switched on / s")
    axes.set_ylabel("level above the settled one / %")
    axes.legend()


FIGURES: Final[dict[str, Callable[[Any], Figure]]] = {
    DarkModel.kind: draw_dark,
    WhiteReference.kind: draw_white,
    PhotonTransfer.kind: draw_photon_transfer,
    SignalToNoise.kind: draw_snr,
    LightStability.kind: draw_light,
}

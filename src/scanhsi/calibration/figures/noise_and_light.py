"""Figure 12 of the paper: signal to noise over wavelength and exposure, and the lamp since it was switched on."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scanhsi.calibration.figures.sensor import show_lamp
from scanhsi.calibration.figures.style import sheet
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.wavelength import Wavelength


def draw_noise_and_light(
    snr: SignalToNoise | None, light: LightStability | None, wavelength: Wavelength | None
) -> Figure:
    """Draw what there is of the two.

    Args:
        snr: Signal to noise by exposure and band.
        light: The lamp.
        wavelength: Of the bands, if known for as many bands; else they are numbered.

    Raises:
        ValueError: Neither is given.
    """
    given = snr or light
    if given is None:
        raise ValueError("nothing to draw")
    title = " and ".join(
        ["signal to noise of the white tile"] * (snr is not None) + ["stability of the light"] * (light is not None)
    )
    figure = sheet(title[0].upper() + title[1:], given.provenance)
    panels = list(figure.subplots(1, (snr is not None) + (light is not None), squeeze=False)[0])
    if snr is not None:
        _show_noise(panels[0], snr, wavelength)
    if light is not None:
        show_lamp(panels[-1], light)
    return figure


def _show_noise(axes: Axes, snr: SignalToNoise, wavelength: Wavelength | None) -> None:
    bands = snr.snr_db.shape[1]
    known = wavelength is not None and wavelength.bands == bands
    place = wavelength.nm() if wavelength is not None and known else np.arange(bands, dtype=np.float64)
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, len(snr.exposure_s)))
    order = np.argsort(snr.exposure_s)
    for colour, index in zip(colours, order.tolist(), strict=True):
        label = f"{1000 * float(snr.exposure_s[index]):.3g} ms"
        axes.plot(place, snr.snr_db[index], color=tuple(colour), linewidth=0.9, label=label)
    axes.set_xlabel("wavelength / nm" if known else "band")
    axes.set_ylabel(r"20 log$_{10}$($\mu$ / $\sigma$) / dB")
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.3 * (high - low), high)
    axes.legend(title="exposure", title_fontsize=7, fontsize=6.5, ncols=3, loc="lower center")

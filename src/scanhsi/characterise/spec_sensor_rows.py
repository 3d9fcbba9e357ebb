"""Rows of sensor and light."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.white import WhiteReference
from scanhsi.characterise.spec_row import Make, Row, part


def _dark(result: DarkModel, make: Make) -> list[Row]:
    good = ~(result.hot | result.nonlinear)
    count = math.sqrt(good.sum())
    rate, offset = result.rate[good], result.offset[good]
    return [
        make("dark current", "Dark current, mean", float(rate.mean()), "counts/s", float(rate.std()) / count),
        make("dark offset", "Dark offset, mean", float(offset.mean()), "counts", float(offset.std()) / count),
        make("hot pixels", "Hot pixels", float(result.hot.mean()), "", text=part(result.hot)),
        make(
            "nonlinear pixels",
            "Pixels not linear in the dark",
            float(result.nonlinear.mean()),
            "",
            text=part(result.nonlinear),
        ),
    ]


def _white(result: WhiteReference, make: Make) -> list[Row]:
    signal = result.mean - result.dark
    known = np.isfinite(signal) & (signal > 0)
    error = float(np.median(result.sigma[known] / signal[known])) if known.any() else math.nan
    return [make("white", "White reference, standard error of a pixel", 100 * error, "%")]


def _photon_transfer(result: PhotonTransfer, make: Make) -> list[Row]:
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


def _snr(result: SignalToNoise, make: Make) -> list[Row]:
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


def _light(result: LightStability, make: Make) -> list[Row]:
    return [
        make("lamp settling", "Lamp, time constant of settling", result.settling_s, "s", result.settling_sigma_s),
        make("lamp stable", "Lamp, within 1 % after", result.stable_after_s, "s"),
        make("lamp drift", "Lamp, drift a minute", 100 * result.drift_per_min, "%"),
    ]


ROWS: Final[dict[str, Callable[[Any, Make], list[Row]]]] = {
    DarkModel.kind: _dark,
    WhiteReference.kind: _white,
    PhotonTransfer.kind: _photon_transfer,
    SignalToNoise.kind: _snr,
    LightStability.kind: _light,
}
"""Kind of a result -> its rows."""

"""What a scan will cost, from the delays of the instrument: for every mode and pixel format, and what to improve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from scanhsi.devices import PixelFormat
from scanhsi.timing.bounds import earliest, mean_period_ns
from scanhsi.timing.closed_forms import MODES, critical, gains_s, latency_s, scan_s
from scanhsi.timing.devices import InstrumentTiming
from scanhsi.timing.model import efficiency
from scanhsi.timing.smear import motion_mtf, smear_part

_LEAST_DRAWN: Final = 400
_MOST_DRAWN: Final = 2000


@dataclass(frozen=True, slots=True)
class Prediction:
    """One mode with one pixel format.

    Attributes:
        mode: ``sequential``, ``stepped`` or ``continuous``.
        pixel_format: On the link.
        period_s: Expected line period: that of the earliest schedule with delays drawn from the profile.
        means_period_s: The closed form with the means of all delays, which random delays can only exceed (Jensen).
        lines_per_second: 1 / period.
        efficiency: T_exp / period (Eq. 3).
        scan_s: First exposure to last line stored; homing and the way to the first line come before it.
        circuit: What sets the pace, by the closed form.
        critical: Its terms.
        smear: Part of a line pitch that passes during an exposure; 0 where the mirror stands.
        mtf: Contrast that this leaves at the Nyquist frequency of the lines.
    """

    mode: str
    pixel_format: PixelFormat
    period_s: float
    means_period_s: float
    lines_per_second: float
    efficiency: float
    scan_s: float
    circuit: str
    critical: tuple[str, ...]
    smear: float
    mtf: float


def predict(
    timing: InstrumentTiming,
    mode: str,
    pixel_format: PixelFormat,
    *,
    exposure_s: float,
    lines: int,
    step: int,
    period_s: float | None = None,
) -> Prediction:
    """Predict one mode with one pixel format.

    Args:
        timing: Of the instrument.
        mode: ``sequential``, ``stepped`` or ``continuous``.
        pixel_format: One of ``timing.formats``.
        exposure_s: Of a line.
        lines: Of the scan.
        step: Motor steps from line to line.
        period_s: Line period asked for in a continuous scan; the shortest if None, or if that is longer.
    """
    terms, layout = timing.terms(exposure_s, pixel_format, step), timing.layout
    slowest = critical(terms, mode, layout)
    drawn = timing.delays(min(max(lines, _LEAST_DRAWN), _MOST_DRAWN), exposure_s, pixel_format, step)
    shortest_s = mean_period_ns(earliest(drawn, mode).stored) * 1e-9
    sweeps = mode == "continuous"
    expected_s = max(shortest_s, period_s or 0.0) if sweeps else shortest_s
    smear = smear_part(exposure_s, expected_s) if sweeps else 0.0
    return Prediction(
        mode=mode,
        pixel_format=pixel_format,
        period_s=expected_s,
        means_period_s=slowest.period_s(terms),
        lines_per_second=1 / expected_s,
        efficiency=efficiency(exposure_s, expected_s),
        scan_s=scan_s(lines, expected_s, latency_s(terms, mode)),
        circuit=slowest.name,
        critical=tuple(name for name in slowest.terms if terms.get(name) > 0),
        smear=smear,
        mtf=motion_mtf(smear),
    )


def predict_all(
    timing: InstrumentTiming, *, exposure_s: float, lines: int, step: int, period_s: float | None = None
) -> list[Prediction]:
    """`predict` for every mode and every pixel format whose delays are known."""
    return [
        predict(timing, mode, kind, exposure_s=exposure_s, lines=lines, step=step, period_s=period_s)
        for mode in MODES
        for kind in timing.formats
    ]


def lead_s(timing: InstrumentTiming, probability: float) -> float:
    """By how much look-ahead sends a move early, once it knows the latencies: their quantile at the accepted probability.

    0 where the profile has no T_cmd: the mirror then counts as moving from the command on.
    """
    if "T_cmd" not in timing.actuator.profile.streams:
        return 0.0
    streams = timing.actuator.streams
    latency_ns = streams.array_ns("T_rand", _MOST_DRAWN) + streams.array_ns("T_cmd", _MOST_DRAWN)
    return float(np.quantile(latency_ns, probability)) * 1e-9


@dataclass(frozen=True, slots=True)
class Gain:
    """What a shorter delay is worth.

    Attributes:
        term: Name of the delay.
        now_s: Its mean.
        period_s: What the line period loses.
        scan_s: What the whole scan loses.
    """

    term: str
    now_s: float
    period_s: float
    scan_s: float


def gains(
    timing: InstrumentTiming,
    mode: str,
    pixel_format: PixelFormat,
    *,
    exposure_s: float,
    lines: int,
    step: int,
    saving_s: float = 1e-3,
) -> Sequence[Gain]:
    """What ``saving_s`` less of each term gains, by the closed form of the means; the exposure itself is left out.

    The most worthwhile comes first; terms that are 0 already are left out.
    """
    terms = timing.terms(exposure_s, pixel_format, step)
    saved = gains_s(terms, mode, timing.layout, saving_s)
    saved.pop("T_exp", None)
    found = [Gain(name, terms.get(name), gain_s, lines * gain_s) for name, gain_s in saved.items()]
    return sorted(found, key=lambda gain: -gain.period_s)

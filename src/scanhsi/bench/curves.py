"""From the observations of a sweep to its curves: one for each mode, pixel format and scenario, with the law fitted to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanhsi.bench.fits import Law, fit_additive, fit_overlapped
from scanhsi.bench.observations import Observation
from scanhsi.engine import Mode


@dataclass(frozen=True, slots=True)
class Curve:
    """Line period as a function of exposure.

    Attributes:
        mode, scenario, pixel_format: Of all its scans.
        exposure_s: float64 (n,), ascending.
        period_s: float64 (n,), mean line period.
        law: Fitted to it: additive for sequential scans, overlapped else.
        lines: Lines measured.
        missing: Lines lost.
    """

    mode: str
    scenario: str
    pixel_format: str
    exposure_s: NDArray[np.float64]
    period_s: NDArray[np.float64]
    law: Law
    lines: int
    missing: int


def curves(observations: Sequence[Observation]) -> list[Curve]:
    """Curves in the order in which they were first measured. A scan that delivered fewer than two lines has no period."""
    sorted_out: dict[tuple[str, str, str], list[Observation]] = {}
    for seen in observations:
        if len(seen.periods_s):
            sorted_out.setdefault((seen.mode, seen.scenario, seen.pixel_format), []).append(seen)
    return [_curve(scans) for scans in sorted_out.values()]


def _curve(scans: list[Observation]) -> Curve:
    scans = sorted(scans, key=lambda seen: seen.exposure_s)
    exposures, periods = [seen.exposure_s for seen in scans], [seen.periods_s for seen in scans]
    fit = fit_additive if scans[0].mode == Mode.SEQUENTIAL else fit_overlapped
    return Curve(
        mode=scans[0].mode,
        scenario=scans[0].scenario,
        pixel_format=scans[0].pixel_format,
        exposure_s=np.array(exposures),
        period_s=np.array([period.mean() for period in periods]),
        law=fit(exposures, periods),
        lines=sum(seen.lines for seen in scans),
        missing=sum(len(seen.missing) for seen in scans),
    )

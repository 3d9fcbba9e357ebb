"""Whether two delay profiles differ, stream by stream, and whether that matters: line period and lost lines when replayed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices import PixelFormat
from scanhsi.devices.errors import ConfigError
from scanhsi.timing.bounds import LineDelays, earliest, mean_period_ns
from scanhsi.timing.closed_forms import MODES, Layout
from scanhsi.timing.delays import DelayProfile, Stream
from scanhsi.timing.devices import DeviceTiming, InstrumentTiming
from scanhsi.timing.drops import lost
from scanhsi.timing.two_sample import two_sample

LEVEL: Final = 0.05
"""Probability, over all streams, of a difference where there is none."""
FEWEST: Final = 10
"""Independent delays below which nothing is told."""
REPLAYS: Final = 40
_SWEEP_MARGIN: Final = 1.01
_FORMATTED: Final = ("T_rx", "T_mcpy")


@dataclass(frozen=True, slots=True)
class StreamComparison:
    """One stream of both profiles.

    Attributes:
        stream, pixel_format: Which; the format where delays depend on it.
        lines: Delays measured, in both.
        independent: Of them compared, so many lines apart as makes them independent.
        median_s, p99_s: In both.
        distance, p, visible: `scanhsi.timing.two_sample.Difference`; p is corrected for the number of streams (Holm).
        verdict: ``differ``, ``no difference seen`` or ``too few lines``.
    """

    stream: Stream
    pixel_format: str | None
    lines: tuple[int, int]
    independent: tuple[int, int]
    median_s: tuple[float, float]
    p99_s: tuple[float, float]
    distance: float
    p: float
    visible: float
    verdict: str


def compare_streams(first: DelayProfile, second: DelayProfile) -> list[StreamComparison]:
    """Compare each stream that both profiles have recorded, per pixel format where it depends on it."""
    found: list[StreamComparison] = []
    for stream in get_args(Stream):
        for pixel_format in _formats(stream, first, second):
            samples = [_delays(profile, stream, pixel_format) for profile in (first, second)]
            if all(len(whole) for whole, _ in samples):
                found.append(_compared(stream, pixel_format, samples))
    return _corrected(found)


def _formats(stream: Stream, first: DelayProfile, second: DelayProfile) -> Sequence[str | None]:
    if stream not in _FORMATTED:
        return (None,)
    also = {scan.pixel_format for scan in second.scans}
    return list(dict.fromkeys(scan.pixel_format for scan in first.scans if scan.pixel_format in also))


def _delays(profile: DelayProfile, stream: Stream, pixel_format: str | None) -> tuple[NDArray[Any], NDArray[Any]]:
    """All delays of a stream in ns, and those far enough from each other to be independent."""
    model = profile.streams.get(stream)
    known = model.dependence if model else None
    every = math.ceil(known.length) if known else 1
    per_step_ns = profile.per_step_s(stream) * 1e9
    scans = [
        np.array([ns - per_step_ns * scan.steps for ns in scan.delays_ns.get(stream, ()) if ns is not None])
        for scan in profile.scans
        if pixel_format in (None, scan.pixel_format)
    ]
    scans.append(np.empty(0))
    return np.concatenate(scans), np.concatenate([scan[::every] for scan in scans])


def _compared(
    stream: Stream, pixel_format: str | None, samples: Sequence[tuple[NDArray[Any], NDArray[Any]]]
) -> StreamComparison:
    (first, first_apart), (second, second_apart) = samples
    told = two_sample(first_apart, second_apart)
    low, high = ([float(np.quantile(whole, p)) * 1e-9 for whole in (first, second)] for p in (0.5, 0.99))
    return StreamComparison(
        stream=stream,
        pixel_format=pixel_format,
        lines=(len(first), len(second)),
        independent=(len(first_apart), len(second_apart)),
        median_s=(low[0], low[1]),
        p99_s=(high[0], high[1]),
        distance=told.distance,
        p=told.p,
        visible=told.visible,
        verdict="too few lines" if min(len(first_apart), len(second_apart)) < FEWEST else "",
    )


def _corrected(streams: Sequence[StreamComparison]) -> list[StreamComparison]:
    """With p values that hold for all streams together, and verdicts (Holm, *Scand. J. Stat.* 6, 65, 1979)."""
    tested = sorted((each for each in streams if not each.verdict), key=lambda each: each.p)
    corrected: dict[tuple[str, str | None], float] = {}
    least = 0.0
    for place, each in enumerate(tested):
        least = max(least, min(each.p * (len(tested) - place), 1.0))
        corrected[each.stream, each.pixel_format] = least
    told: list[StreamComparison] = []
    for each in streams:
        p = corrected.get((each.stream, each.pixel_format), math.nan)
        verdict = each.verdict or ("differ" if p < LEVEL else "no difference seen")
        told.append(replace(each, p=p, verdict=verdict))
    return told


@dataclass(frozen=True, slots=True)
class ReplayPlan:
    """The scan that both profiles are replayed in.

    Attributes:
        exposure_s: Of a line.
        pixel_format: On the link.
        lines: Of one replay.
        step: Motor steps from line to line.
        period_s: Line period of the sweep in which lines are lost.
        layout: Buffers; whether the sensor overlaps.
    """

    exposure_s: float
    pixel_format: PixelFormat
    lines: int
    step: int
    period_s: float
    layout: Layout


def replay_plan(
    first: DelayProfile,
    second: DelayProfile,
    *,
    exposure_s: float | None = None,
    pixel_format: PixelFormat | None = None,
    lines: int | None = None,
    step: int | None = None,
    period_s: float | None = None,
    layout: Layout | None = None,
) -> ReplayPlan:
    """A plan for both: what is not given is as in the first recorded scan, or what the engine would choose.

    So many lines are replayed as the smaller recording has (50 to 1000), so that the scatter of replays tells how far the recording
    itself can be trusted. The sweep is the fastest that both cameras can follow on average.

    Raises:
        ConfigError: There is no pixel format whose delays both profiles know.
    """
    layout = layout or Layout()
    scans = [*first.scans, *second.scans]
    timings = [_timing(profile, 0, layout) for profile in (first, second)]
    common = [kind for kind in timings[0].formats if kind in timings[1].formats]
    wanted = common if pixel_format is None else [kind for kind in common if kind == pixel_format]
    if not wanted:
        asked = "no pixel format" if pixel_format is None else f"not {pixel_format}"
        raise ConfigError(
            f"profiles {first.name} and {second.name} have {asked} in common; they have {', '.join(common) or 'none'}."
        )
    recorded = [kind for kind in wanted if any(scan.pixel_format == kind for scan in scans)]
    kind = (recorded or wanted)[0]
    exposure_s = exposure_s or (scans[0].exposure_ns * 1e-9 if scans else 0.02)
    step = step or (scans[0].steps if scans else 1)
    counts = [sum(scan.lines for scan in profile.scans) or 1000 for profile in (first, second)]
    terms = [timing.terms(exposure_s, kind, step) for timing in timings]
    shortest_s = max(
        max(exposure_s + each.T_dead_s, each.T_rd_s, _SWEEP_MARGIN * (each.T_rx_s + each.T_api_s)) for each in terms
    )
    return ReplayPlan(
        exposure_s=exposure_s,
        pixel_format=kind,
        lines=lines or min(max(min(counts), 50), 1000),
        step=step,
        period_s=period_s or shortest_s,
        layout=layout,
    )


def _timing(profile: DelayProfile, seed: int, layout: Layout) -> InstrumentTiming:
    device = DeviceTiming(profile, seed, overlap=layout.overlap)
    return InstrumentTiming(device, device, buffers=layout)


@dataclass(frozen=True, slots=True)
class ReplayComparison:
    """One figure of merit under replay of both profiles.

    Attributes:
        name: ``period sequential``, ``period stepped``, ``period continuous`` (s) or ``lines lost`` (part of all).
        means: Over the replays of each profile.
        difference: Second less first.
        low, high: Interval of 95 % of the difference.
        verdict: ``differ`` or ``no difference seen``.
    """

    name: str
    means: tuple[float, float]
    difference: float
    low: float
    high: float
    verdict: str


def compare_replays(first: DelayProfile, second: DelayProfile, plan: ReplayPlan) -> list[ReplayComparison]:
    """Replay both profiles 40 times each, by the recursion of `scanhsi.timing.bounds`, with different seeds."""
    columns: list[dict[str, list[float]]] = []
    for offset, profile in ((0, first), (REPLAYS, second)):
        figures: dict[str, list[float]] = {}
        for seed in range(offset, offset + REPLAYS):
            delays = _timing(profile, seed, plan.layout).delays(
                plan.lines, plan.exposure_s, plan.pixel_format, plan.step
            )
            for name, figure in _FIGURES.items():
                figures.setdefault(name, []).append(figure(delays, plan))
        columns.append(figures)
    return [_figure(name, np.array(columns[0][name]), np.array(columns[1][name])) for name in _FIGURES]


def _period_s(mode: str) -> Callable[[LineDelays, ReplayPlan], float]:
    return lambda delays, plan: mean_period_ns(earliest(delays, mode).stored) * 1e-9


def _lost(delays: LineDelays, plan: ReplayPlan) -> float:
    return float(lost(delays, round(plan.period_s * 1e9)).mean())


_FIGURES: Final = {**{f"period {mode}": _period_s(mode) for mode in MODES}, "lines lost": _lost}


def _figure(name: str, first: NDArray[np.float64], second: NDArray[np.float64]) -> ReplayComparison:
    difference = float(second.mean() - first.mean())
    half = 1.96 * math.hypot(float(first.std(ddof=1)), float(second.std(ddof=1)))
    same = abs(difference) <= max(half, 1e-12)
    return ReplayComparison(
        name=name,
        means=(float(first.mean()), float(second.mean())),
        difference=difference,
        low=difference - half,
        high=difference + half,
        verdict="no difference seen" if same else "differ",
    )

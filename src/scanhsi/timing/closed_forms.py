"""Closed forms of the line period: the slowest circuit of the schedule.

With constant delays the earliest schedule of `scanhsi.timing.bounds` settles to a period that is the largest mean weight of its
circuits, weight over tokens: a circuit is a chain of delays that leads from a line to the line so many (its *tokens*) later
(Baccelli, Cohen, Olsder, Quadrat, *Synchronization and Linearity*). Each is a plain sum of terms, so the slowest one also says
which terms set the pace and what one of them less would gain.

With random delays the period of the means is a lower bound (Jensen): the recursion with drawn delays tells what is to be expected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from scanhsi.timing.model import Terms

MODES = ("sequential", "stepped", "continuous")
_MOVE = ("T_rand", "T_act", "settle")


@dataclass(frozen=True, slots=True)
class Layout:
    """What of an instrument is not a delay.

    Attributes:
        overlap: Whether the sensor exposes while it reads the last frame out.
        buffers: Frame buffers of the camera: a line needs one until it is unpacked.
        line_buffers: Line buffers of storage: a line needs one until it is stored.
    """

    overlap: bool = True
    buffers: int = 16
    line_buffers: int = 16


@dataclass(frozen=True, slots=True)
class Circuit:
    """A chain of delays from a line to the line ``tokens`` later.

    Attributes:
        name: What it goes through.
        terms: Names of the delays.
        tokens: Lines from its begin to its end.
    """

    name: str
    terms: tuple[str, ...]
    tokens: int = 1

    def period_s(self, terms: Terms) -> float:
        """Line period that this circuit alone allows."""
        return terms.total_s(self.terms) / self.tokens


def circuits(mode: str, layout: Layout) -> tuple[Circuit, ...]:
    """All circuits of a mode.

    Args:
        mode: ``sequential``, ``stepped`` or ``continuous``.
        layout: Of the instrument.

    Raises:
        ValueError: No such mode.
    """
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, not {mode!r}")
    return (*_stages(layout), *_motion(mode), *_credits(mode, layout))


def _stages(layout: Layout) -> Iterator[Circuit]:
    if layout.overlap:
        yield Circuit("exposure", ("T_exp", "T_dead"))
        yield Circuit("read-out", ("T_rd",))
    else:
        yield Circuit("expose, read out", ("T_exp", "T_rd"))
    yield Circuit("link", ("T_rx", "T_api"))
    yield Circuit("copy", ("T_mcpy",))
    yield Circuit("storage", ("T_store",))


def _motion(mode: str) -> Iterator[Circuit]:
    if mode == "stepped":
        yield Circuit("expose, move", ("T_exp", "T_ev", *_MOVE, "T_trig"))
    elif mode == "sequential":
        for way in _arrivals(mode):
            yield Circuit("all in turn", ("T_exp", *way, "T_mcpy", "T_store", *_MOVE, "T_trig"))


def _credits(mode: str, layout: Layout) -> Iterator[Circuit]:
    trigger = () if mode == "continuous" else ("T_trig",)
    for way in _arrivals(mode):
        latency = (*trigger, "T_exp", *way, "T_mcpy")
        yield Circuit("camera buffers", latency, layout.buffers)
        yield Circuit("line buffers", (*latency, "T_store"), layout.line_buffers)


def _arrivals(mode: str) -> Iterator[tuple[str, ...]]:
    """What can pass between the end of an exposure and the begin of its copy: the longest counts."""
    yield ("T_rd",)
    yield ("t1", "T_rx", "T_api")
    if mode != "continuous":
        yield ("T_ev",)


def critical(terms: Terms, mode: str, layout: Layout) -> Circuit:
    """The slowest circuit, which sets the line period; of equally slow ones that with the fewest terms."""
    return max(circuits(mode, layout), key=lambda circuit: (circuit.period_s(terms), -len(circuit.terms)))


def line_period_s(terms: Terms, mode: str, layout: Layout) -> float:
    """Line period of a mode with constant delays, in s."""
    return critical(terms, mode, layout).period_s(terms)


def latency_s(terms: Terms, mode: str) -> float:
    """Time L from the start of an exposure to its line stored, when nothing is waited for, in s."""
    return terms.T_exp_s + max(terms.total_s(way) for way in _arrivals(mode)) + terms.T_mcpy_s + terms.T_store_s


def scan_s(lines: int, period_s: float, latency_s: float, *, home_s: float = 0.0, return_s: float = 0.0) -> float:
    """Time of a whole scan: (N - 1) periods and the latency of the last line, plus homing and the way back, in s."""
    return (lines - 1) * period_s + latency_s + home_s + return_s


def gains_s(terms: Terms, mode: str, layout: Layout, saving_s: float = 1e-3) -> dict[str, float]:
    """What ``saving_s`` less of each term would take off the line period, in s; terms that are 0 are left out."""
    now_s = line_period_s(terms, mode, layout)
    present = (name for name in Terms.names() if terms.get(name) > 0)
    return {name: now_s - line_period_s(terms.less(name, saving_s), mode, layout) for name in present}

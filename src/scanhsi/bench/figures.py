"""The figures of a line benchmark, numbered as in the paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scanhsi.bench.curves import Curve
from scanhsi.bench.observations import Session
from scanhsi.bench.rates import draw_efficiencies, draw_rates
from scanhsi.bench.stacks import draw_stacks
from scanhsi.bench.style import save, source_of


def draw_figures(session: Session, curves: Sequence[Curve], folder: Path) -> list[Path]:
    """Write figures 5, 6 and 13, as far as there is something to draw; return the files.

    Raises:
        CubeError: A file cannot be written.
    """
    if not curves:
        return []
    source = source_of(session.facts)
    paths = save(lambda: draw_rates(curves, source), folder, "figure6-lines-per-second")
    if any(curve.scenario == "full" for curve in curves):
        paths += save(lambda: draw_stacks(session), folder, "figure5-time-per-line")
        paths += save(lambda: draw_efficiencies(curves, source), folder, "figure13-efficiency")
    return sorted(paths)

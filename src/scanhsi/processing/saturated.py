"""From which count on pixels are saturated: seen while a cube is processed, and put right where it was not known before.

A sensor may saturate at a plateau below full scale, which only the counts of the whole cube tell. So the upper end of their
histogram is kept while shards are made, with full scale as the level. Where a plateau shows in the end, the shards that reach it
are made once more with that level, before the new cube counts as complete; as a rule none shows, and nothing is read twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from scanhsi.calibration.saturation import TopCounts
from scanhsi.cube.rewrite import Review
from scanhsi.log import get_logger
from scanhsi.processing.functions import Values
from scanhsi.processing.pipeline import Pipeline
from scanhsi.processing.signal import Signal
from scanhsi.processing.steps import MaskSaturated, Step

_BANDS_AT_ONCE: Final = 32
_log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Tops:
    """Looks at the upper end of the counts."""

    full_scale: int

    def __call__(self, lines: Values) -> TopCounts:
        """Of some lines."""
        found = TopCounts(self.full_scale)
        for first in range(
            0, len(lines), _BANDS_AT_ONCE
        ):  # in one piece in memory, and most of them dark: quickly done
            found.add(lines[first : first + _BANDS_AT_ONCE])
        return found


@dataclass(frozen=True)
class Plateau:
    """Draws the conclusion: level and provenance, and what is to be made again."""

    input: Signal
    steps: Sequence[Step]
    full_scale: int

    def __call__(self, found: Mapping[int, TopCounts]) -> Review:
        """From the upper end of each shard."""
        whole = TopCounts(self.full_scale)
        for tops in found.values():
            whole.merge(tops)
        level = whole.plateau()
        if level is None:
            return Review({"saturation": {"level": float(self.full_scale), "from": "full scale"}})
        again = [first for first, tops in sorted(found.items()) if tops.top >= level]
        _log.info("saturated below full scale", operation="process", level=level, full_scale=self.full_scale)
        steps = [MaskSaturated(level), *self.steps[1:]]
        return Review({"saturation": {"level": float(level), "from": "plateau"}}, Pipeline(self.input, steps), again)


def plateau_in(start: Signal, steps: Sequence[Step]) -> Plateau | None:
    """What looks for a plateau; None where nothing is masked first, or the level is given."""
    counts = start.units == "counts" and start.dtype.kind == "u" and start.saturation is not None
    if not counts or not steps or not isinstance(steps[0], MaskSaturated) or steps[0].level is not None:
        return None
    assert start.saturation is not None
    return Plateau(start, steps, int(start.saturation))

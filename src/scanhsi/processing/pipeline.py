"""Steps in a row, bound to what goes in: the same on a shard of a cube and on one line as it arrives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from scanhsi.processing.signal import Signal
from scanhsi.processing.steps import Bound, Step, Values

_BLOCK_BYTES = (
    8_000_000  # raw; some lines at a time, so that what the steps pass on stays in the processor's cache's reach
)


@dataclass(frozen=True)
class Pipeline:
    """Some steps, bound to a signal.

    Attributes:
        input: What goes in.
        steps: In order.
        output: What comes out.

    Raises:
        CalibrationError: A step does not fit what it gets.
    """

    input: Signal
    steps: Sequence[Step]
    output: Signal = field(init=False)
    _bound: list[Bound] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        signal, bound = self.input, list[Bound]()
        for step in self.steps:
            signal, function = step.bind(signal)
            bound.append(function)
        object.__setattr__(self, "output", signal)
        object.__setattr__(self, "_bound", bound)

    def __call__(self, lines: Values) -> Values:
        """Process some whole lines.

        Args:
            lines: (band, line, sample) as `input` says; or one line, (band, sample).

        Returns:
            The same lines as `output` says.
        """
        if lines.ndim == 2:
            return self(lines[:, None, :])[:, 0, :]
        bands, count, samples = lines.shape
        out = np.empty((self.output.bands, count, self.output.samples), self.output.dtype)
        at_once = max(1, _BLOCK_BYTES // (bands * samples * lines.dtype.itemsize))
        for first in range(0, count, at_once):
            some = slice(first, first + at_once)
            values = lines[:, some]
            for function in self._bound:
                values = function(values)
            out[:, some] = values
        return out

    def describe(self) -> list[dict[str, Any]]:
        """The steps with their parameters and sources, for the provenance of what comes out."""
        return [{"step": step.name, **step.describe()} for step in self.steps]

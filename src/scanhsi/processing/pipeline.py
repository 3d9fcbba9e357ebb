"""Steps in a row, bound to what goes in: the same on a shard of a cube and on one line as it arrives."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from scanhsi.processing.banded import AlongBands, Banded
from scanhsi.processing.functions import Bound, Masked, Values, same
from scanhsi.processing.kernel import Kernel
from scanhsi.processing.signal import Signal
from scanhsi.processing.steps import Step

_SAMPLES_AT_ONCE: Final = 320
_BLOCK_BYTES: Final = 8_000_000  # raw: some lines at a time, so that what the steps pass on stays in the cache


@dataclass(frozen=True)
class Pipeline:
    """Some steps, bound to a signal.

    Attributes:
        input: What goes in.
        steps: In order.
        output: What comes out.
        bound: What each step takes, and its function.

    Raises:
        CalibrationError: A step does not fit what it gets.
    """

    input: Signal
    steps: Sequence[Step]
    output: Signal = field(init=False)
    bound: list[tuple[Signal, Bound]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        signal, bound = self.input, list[tuple[Signal, Bound]]()
        for step in self.steps:
            taken = signal
            signal, function = step.bind(taken)
            bound.append((taken, function))
        object.__setattr__(self, "output", signal)
        object.__setattr__(self, "bound", bound)

    @functools.cached_property
    def functions(self) -> list[Bound]:
        """What is computed, in order: fewer than steps where several became one. Worked out when first used."""
        return fused(self.bound)

    def __call__(self, lines: Values) -> Values:
        """Process some whole lines.

        Args:
            lines: (band, line, sample) as `input` says; or one line, (band, sample).

        Returns:
            The same lines as `output` says.
        """
        if lines.ndim == 2:
            return self(lines[:, None, :])[:, 0, :]
        if len(self.functions) == 1 and isinstance(self.functions[0], Kernel):
            return self.functions[0](lines)
        bands, count, samples = lines.shape
        out = np.empty((self.output.bands, count, self.output.samples), self.output.dtype)
        at_once = max(1, _BLOCK_BYTES // (bands * samples * lines.dtype.itemsize))
        for first in range(0, count, at_once):
            some = slice(first, first + at_once)
            values = lines[:, some]
            for function in self.functions:
                values = function(values)
            out[:, some] = values
        return out

    def describe(self) -> list[dict[str, Any]]:
        """The steps with their parameters and sources, for the provenance of what comes out."""
        return [{"step": step.name, **step.describe()} for step in self.steps]


def fused(bound: Sequence[tuple[Signal, Bound]]) -> list[Bound]:
    """Functions, each with what it takes, that come to the same with fewer passes over the lines.

    A run of sums along the bands becomes one, with the masking of what is saturated if the run begins with it.
    """
    made, run = list[Bound](), _Run()
    for signal, function in bound:
        if function is same:
            continue
        if isinstance(function, Masked):
            made += run.end()
            run = _Run(mask=function)
        elif (sums := _sums(function, signal)) is not None:
            run.sums.append((signal, sums))
        else:
            made += [*run.end(), function]
            run = _Run()
    return [*made, *run.end()]


def _sums(function: Bound, signal: Signal) -> AlongBands | None:
    if isinstance(function, AlongBands) and function.banded(signal.bands, slice(0, 1)) is not None:
        return function
    return None


@dataclass
class _Run:
    """Functions that become one: first perhaps a mask, then sums, each with what it takes."""

    mask: Masked | None = None
    sums: list[tuple[Signal, AlongBands]] = field(default_factory=list[tuple[Signal, AlongBands]])

    def end(self) -> list[Bound]:
        """What they come to."""
        if self.sums:
            return [Kernel(self._together(), self.mask.level if self.mask else np.inf)]
        return [self.mask] if self.mask else []

    def _together(self) -> Iterator[tuple[slice, Banded]]:
        """The sums as one, for some samples after the other: in float64 they take much memory."""
        samples = self.sums[0][0].samples
        for first in range(0, samples, _SAMPLES_AT_ONCE):
            some = slice(first, min(first + _SAMPLES_AT_ONCE, samples))
            whole: Banded | None = None
            for signal, function in self.sums:
                one = function.banded(signal.bands, some)
                assert one is not None, "asked before"
                whole = one if whole is None else one.after(whole)
            assert whole is not None, "there is one"
            yield some, whole

"""Ranges of values a device allows, and the one way to refuse a value outside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scanhsi.devices.errors import OutOfRange


def _written(value: float) -> str:
    """All digits of a whole number: steps and pixels are counted, not rounded."""
    return f"{value:.0f}" if math.isfinite(value) and value == round(value) and abs(value) < 1e15 else f"{value:g}"


@dataclass(frozen=True, slots=True)
class Range:
    """Allowed values ``minimum, minimum + step, ... <= maximum``; ``step`` 0 means any value between.

    Args:
        minimum: Smallest allowed value, in ``unit``.
        maximum: Largest allowed value, in ``unit``.
        step: Distance of two allowed values, or 0.
        unit: Unit of the numbers, for messages (``"s"``, ``"dB"``, ``"px"``, ``"steps"``).
    """

    minimum: float
    maximum: float
    step: float = 0.0
    unit: str = ""

    def __contains__(self, value: float) -> bool:
        if not self.minimum <= value <= self.maximum:  # also refuses nan
            return False
        if not self.step:
            return True
        steps = (value - self.minimum) / self.step
        return math.isclose(steps, round(steps), abs_tol=1e-6)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        step = f" in steps of {self.step:g}" if self.step else ""
        return f"{_written(self.minimum)} to {_written(self.maximum)}{unit}{step}"

    def check(self, name: str, value: float, *, device: str | None = None, hint: str | None = None) -> None:
        """Refuse a value outside the range.

        Raises:
            OutOfRange: Names the quantity, the value and what is allowed.
        """
        if value not in self:
            unit = f" {self.unit}" if self.unit else ""
            raise OutOfRange(
                f"{name} {_written(value)}{unit} is not allowed; allowed is {self}.",
                device=device,
                operation=f"set {name}",
                hint=hint,
            )

"""What the driver needs of the controller's ``$`` settings, and the travel that follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from scanhsi.devices.errors import ProtocolError, UnsupportedFeature

_FINEST_STEPS_PER_UNIT = 1000.0  # positions are told in thousandths of the unit


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis as the controller is set up; its unit is called mm, whatever it stands for.

    Attributes:
        steps_per_mm: ``$100`` to ``$102``.
        rate_mm_min: Highest speed, ``$110`` to ``$112``.
        acceleration_mm_s2: ``$120`` to ``$122``.
        travel_mm: Length of the axis, ``$130`` to ``$132``.
        soft_limits: The controller refuses targets outside its travel (``$20``).
        homing: It has a home switch (``$22``).
        homes_down: It seeks the switch towards lower positions (``$23``).
        pull_off_mm: Way back from the switch (``$27``).
        origin_at_switch: Built so that homing ends at machine position 0 (letter Z in the options of ``$I``).
    """

    steps_per_mm: float
    rate_mm_min: float
    acceleration_mm_s2: float
    travel_mm: float
    soft_limits: bool
    homing: bool
    homes_down: bool
    pull_off_mm: float
    origin_at_switch: bool

    def steps(self, position_mm: float) -> int:
        """Nearest whole step of a machine position."""
        return round(position_mm * self.steps_per_mm)

    @property
    def home_step(self) -> int:
        """Machine step at which homing ends; 0 without a switch."""
        if not self.homing or self.origin_at_switch:
            return 0
        return self.steps(self.pull_off_mm - self.travel_mm if self.homes_down else -self.pull_off_mm)

    @property
    def travel_steps(self) -> tuple[float, float]:
        """Machine steps that the controller allows."""
        if not self.soft_limits:
            return -math.inf, math.inf
        travel = self.travel_mm * self.steps_per_mm
        return (0.0, travel) if self.origin_at_switch and self.homes_down else (-travel, 0.0)

    def move_time_s(self, steps: int, rate_mm_min: float) -> float:
        """Time of a move from rest to rest: trapezoid or triangle."""
        distance, rate, acceleration = abs(steps) / self.steps_per_mm, rate_mm_min / 60, self.acceleration_mm_s2
        if distance * acceleration < rate**2:
            return 2 * math.sqrt(distance / acceleration)
        return distance / rate + rate / acceleration


def read_axis(settings: Mapping[int, float], options: str, index: int, device: str) -> Axis:
    """The axis of that index, from the answers to ``$$`` and ``$I``.

    Raises:
        ProtocolError: A setting is missing.
        UnsupportedFeature: The controller is set up so that steps cannot be told apart.
    """
    needed = (20, 22, 23, 27, *(group + index for group in (100, 110, 120, 130)))
    missing = [f"${number}" for number in needed if number not in settings]
    if missing:
        raise ProtocolError(f"settings {', '.join(missing)} are missing in its list.", device=device, operation="$$")
    axis = Axis(
        steps_per_mm=settings[100 + index],
        rate_mm_min=settings[110 + index],
        acceleration_mm_s2=settings[120 + index],
        travel_mm=settings[130 + index],
        soft_limits=bool(settings[20]),
        homing=bool(int(settings[22]) & 1),
        homes_down=bool(int(settings[23]) >> index & 1),
        pull_off_mm=settings[27],
        origin_at_switch="Z" in options,
    )
    if settings.get(13):
        raise UnsupportedFeature("it reports in inches.", device=device, operation="connect", hint="set $13=0.")
    if not 0 < axis.steps_per_mm <= _FINEST_STEPS_PER_UNIT:
        raise UnsupportedFeature(
            f"${100 + index}={axis.steps_per_mm:g}: positions are told in thousandths, which do not tell single steps apart.",
            device=device,
            operation="connect",
            hint=f"choose a unit of 1000 steps: ${100 + index}=1000, and speed, acceleration and travel in that unit.",
        )
    if min(axis.rate_mm_min, axis.acceleration_mm_s2) <= 0:
        raise UnsupportedFeature("its speed or acceleration is 0.", device=device, operation="connect")
    return axis

"""How long the firmware's motions take: the same ramp, computed beforehand.

Between the first and the last of n steps lie n - 1 intervals. While the motor speeds up the k-th one is
``c_k = c_(k-1) (1 - 2 / (4 (k + k_B) + 1))``; the way down mirrors the way up; none is shorter than 1 / top speed. From rest
``c_0 = 0.676 sqrt(2 / a)``; with a start speed B, ``c_0 = 1 / B`` and ``k_B = B^2 / 2a`` (Austin 2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from math import ceil, sqrt

_FIRST_STEP_S = 20e-6  # direction set-up time before the first step
_LONGEST_TABLE = 20_000  # longer ramps (tiny accelerations) take the closed form


@dataclass(frozen=True, slots=True)
class Profile:
    """What the controller is set to: steps/s, steps/s^2, steps/s. The start speed needs no ramp; 0 = start from rest."""

    top_speed: int
    acceleration: int
    start_speed: int = 0

    @property
    def ramp_steps(self) -> int:
        """Steps needed to reach top speed from rest, rounded up; as many to stop."""
        gained = self.top_speed**2 - min(self.start_speed, self.top_speed) ** 2
        return ceil(gained / (2 * self.acceleration)) + 1


def move_time_s(steps: int, profile: Profile) -> float:
    """Time from the command to the last of `steps` steps, from rest to rest."""
    intervals = abs(steps) - 1
    if intervals < 0:
        return 0.0
    if profile.ramp_steps > _LONGEST_TABLE:
        return _FIRST_STEP_S + _closed_form_s(intervals, profile)
    sums = _ramp_sums(profile)
    ramp = min(len(sums) - 1, intervals // 2)
    middle = intervals - 2 * ramp
    plateau = max(1 / profile.top_speed, sums[ramp + 1] - sums[ramp] if ramp + 1 < len(sums) else 0.0)
    return _FIRST_STEP_S + 2 * sums[ramp] + middle * plateau


def run_up_time_s(steps: int, profile: Profile) -> float:
    """Time from the command to the `steps`-th step of a motion that goes on behind it."""
    intervals = max(abs(steps) - 1, 0)
    sums = _ramp_sums(profile)
    ramp = min(len(sums) - 1, intervals)
    return _FIRST_STEP_S + sums[ramp] + (intervals - ramp) / profile.top_speed


@lru_cache(maxsize=64)
def _ramp_sums(profile: Profile) -> tuple[float, ...]:
    """Times until the end of the 0th, 1st, 2nd, ... interval of the ramp up, in s; as many as are slower than top speed."""
    shortest = 1 / profile.top_speed
    interval = 0.676 * sqrt(2 / profile.acceleration)
    offset = 0
    if profile.start_speed and 1 / profile.start_speed < interval:
        interval = 1 / profile.start_speed
        offset = profile.start_speed**2 // (2 * profile.acceleration)
    intervals: list[float] = []
    while interval > shortest and len(intervals) < _LONGEST_TABLE:
        intervals.append(interval)
        interval *= 1 - 2 / (4 * (len(intervals) + offset) + 1)
    return tuple(accumulate(intervals, initial=0.0))


def _closed_form_s(intervals: int, profile: Profile) -> float:
    speed, acceleration = profile.top_speed, profile.acceleration
    if intervals * acceleration < speed**2:
        return 2 * sqrt(intervals / acceleration)
    return intervals / speed + speed / acceleration

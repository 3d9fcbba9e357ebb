"""What a continuous scan pays for its speed: the mirror moves on while a line is exposed.

Motion during a part d of one line pitch p multiplies contrast at the spatial frequency f by |sin(pi d f p) / (pi d f p)|.
"""

from __future__ import annotations

import math

NYQUIST = 0.5
"""Highest frequency that the line pitch can carry, in cycles per line."""


def smear_part(exposure_s: float, period_s: float) -> float:
    """Part of a line pitch that passes during an exposure: T_exp / line period."""
    return exposure_s / period_s


def motion_mtf(part: float, frequency: float = NYQUIST) -> float:
    """Contrast that is left.

    Args:
        part: As `smear_part` tells.
        frequency: In cycles per line.
    """
    x = math.pi * part * frequency
    return abs(math.sin(x) / x) if x else 1.0


def period_for_smear_s(exposure_s: float, part: float) -> float:
    """Line period at which no more than this part of a pitch is smeared.

    Raises:
        ValueError: ``part`` is not above 0.
    """
    if not part > 0:
        raise ValueError(f"part must be above 0, not {part}")
    return exposure_s / part

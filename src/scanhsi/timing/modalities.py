"""How long a hyperspectral image takes by kind of instrument, with ideal devices (Sensors 2019, 19(7), 1692, Table 6).

"Ideal" means that nothing is counted but the exposure and the motion: `scanhsi.timing.closed_forms` has what a real line costs.
"""

from __future__ import annotations


def snapshot_s(exposure_s: float) -> float:
    """All at once: T_exp."""
    return exposure_s


def staring_s(exposure_s: float, change_s: float, filters: int) -> float:
    """One band at a time behind a filter wheel or a tunable filter: (T_exp + T_change) N_filters."""
    return (exposure_s + change_s) * filters


def whiskbroom_s(exposure_s: float, move_s: float, columns: int, rows: int) -> float:
    """One point at a time: (T_exp + T_move) N_x N_y."""
    return (exposure_s + move_s) * columns * rows


def pushbroom_s(exposure_s: float, move_s: float, lines: int) -> float:
    """One line at a time; the object or the instrument is moved: (T_exp + T_move) N_lines."""
    return (exposure_s + move_s) * lines


def rotating_mirror_s(exposure_s: float, actuate_s: float, lines: int) -> float:
    """One line at a time; only the mirror turns, so T_act is far below T_move: (T_exp + T_act) N_lines."""
    return (exposure_s + actuate_s) * lines

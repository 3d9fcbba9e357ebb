"""What a line costs: the terms of the paper's time model and its equations (Sensors 2019, 19(7), 1692, Eqs. 1 to 4).

The paper prints T_rand once inside T_extra (under Eq. 1) and once beside it (text and Eq. 3); counting it twice would be wrong.
Here T_extra holds the deterministic terms and T_rand stands beside it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """Mean delays of one line, in s, by the names of the paper; the read-out and trigger terms are those of the schedule model.

    Attributes:
        T_exp_s: Exposure.
        T_rx_s: Transfer on the link (Eq. 2).
        T_api_s: Camera API and driver, on the link's time.
        T_mcpy_s: Unpacking and copying.
        T_act_s: Move of the actuator, serial call included.
        settle_s: Settle of the actuator where it is not part of T_act.
        T_rand_s: Disturbance by the host's operating system; the serial call pays for it.
        T_trig_s: Trigger command to start of exposure.
        T_ev_s: End of exposure until the host knows it.
        T_rd_s: Sensor read-out, beside the transfer.
        T_dead_s: Between two overlapped exposures.
        t1_s: End of exposure to the first row on the wire.
        T_store_s: Handing the line over to storage.
    """

    T_exp_s: float
    T_rx_s: float = 0.0
    T_api_s: float = 0.0
    T_mcpy_s: float = 0.0
    T_act_s: float = 0.0
    settle_s: float = 0.0
    T_rand_s: float = 0.0
    T_trig_s: float = 0.0
    T_ev_s: float = 0.0
    T_rd_s: float = 0.0
    T_dead_s: float = 0.0
    t1_s: float = 0.0
    T_store_s: float = 0.0

    @staticmethod
    def names() -> tuple[str, ...]:
        """Names without their unit: ``"T_exp"``, ``"T_rx"``, ..."""
        return tuple(field.name.removesuffix("_s") for field in fields(Terms))

    def get(self, name: str) -> float:
        """One term by its name without unit, in s."""
        return float(getattr(self, f"{name}_s"))

    def total_s(self, names: Iterable[str]) -> float:
        """Sum of some terms, in s."""
        return sum(self.get(name) for name in names)

    def less(self, name: str, saving_s: float) -> Terms:
        """The same with one term shorter, down to 0."""
        return replace(self, **{f"{name}_s": max(self.get(name) - saving_s, 0.0)})

    @property
    def extra_s(self) -> float:
        """T_extra: what a line costs beside its exposure, when all is done in turn and nothing disturbs."""
        return self.total_s(("T_rx", "T_api", "T_mcpy", "T_act", "settle", "T_store"))

    @property
    def line_s(self) -> float:
        """T_line of Eq. 1, the paper's: everything in turn, sensor read-out hidden under the transfer."""
        return self.T_exp_s + self.extra_s + self.T_rand_s

    @property
    def lines_per_second(self) -> float:
        """LPS of Eq. 1."""
        return 1 / self.line_s

    @property
    def efficiency(self) -> float:
        """T_exp / T_line (Eqs. 3 and 4): at most 1, and growing with the exposure time."""
        return efficiency(self.T_exp_s, self.line_s)


def efficiency(exposure_s: float, line_s: float) -> float:
    """T_exp / T_line, which is also T_exp LPS (Eqs. 3 and 4)."""
    return exposure_s / line_s


def image_s(lines: int, line_s: float, *, home_s: float = 0.0, return_s: float = 0.0) -> float:
    """T_img of section 3.6: N T_line + T_home + T_return, in s.

    The paper prints N T_line / efficiency, which counts the overhead twice: T_line is T_exp / efficiency already. Its hand of
    1200 lines of 200 ms takes 280 s, not 327 s.
    """
    return lines * line_s + home_s + return_s

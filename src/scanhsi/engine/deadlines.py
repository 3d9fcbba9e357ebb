"""How long the engine waits for what, and the error it raises then.

A driver has deadlines of its own, tighter and better informed. These stand behind them: whatever a driver does, a scan does not
hang.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from types import TracebackType

from scanhsi.devices import ActuatorInfo, CameraInfo
from scanhsi.devices.errors import DeviceTimeout

MARGIN_S = 5.0
"""Added to what an operation should take: a busy computer, a driver's own retries (GigE Vision waits 2.5 s for an answer)."""
STORE_S = 60.0
"""A writer that has stored nothing for so long is stuck."""
STOP_S = 10.0
"""Stopping the mirror, disarming the camera."""
HOME_S = 120.0
"""Homing may search a whole turn at low speed."""


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Deadlines of one scan, in s, derived from its exposure, read-out and motions."""

    expose_s: float
    frame_s: float
    move_s: float
    first_move_s: float
    store_s: float = STORE_S


def deadlines(camera: CameraInfo, actuator: ActuatorInfo, exposure_s: float, stride: int) -> Deadlines:
    """Derive the deadlines of a scan.

    Args:
        camera: The camera's read-out.
        actuator: The actuator's settling time and range.
        exposure_s: Exposure of a line.
        stride: Steps between lines.
    """
    turn_s = actuator.steps_per_revolution / actuator.max_rate_steps_s
    return Deadlines(
        expose_s=exposure_s + camera.readout_s + MARGIN_S,
        frame_s=camera.readout_s + MARGIN_S,
        move_s=2 * abs(stride) / actuator.max_rate_steps_s + actuator.settle_s + MARGIN_S,
        first_move_s=2 * turn_s + actuator.settle_s + MARGIN_S,
    )


class Deadline:
    """``async with Deadline(limit_s, "expose", device=...)``: like `asyncio.timeout`, but the error names what was waited for."""

    __slots__ = ("_device", "_hint", "_limit_s", "_line", "_operation", "_timer")

    def __init__(
        self, limit_s: float, operation: str, *, device: str, line: int | None = None, hint: str | None = None
    ) -> None:
        self._limit_s = limit_s
        self._operation = operation
        self._device = device
        self._line = line
        self._hint = hint
        self._timer = asyncio.timeout(limit_s)

    async def __aenter__(self) -> None:
        await self._timer.__aenter__()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._timer.__aexit__(kind, error, trace)
        except TimeoutError as expired:
            raise DeviceTimeout(
                "it did not end within its deadline.",
                device=self._device,
                operation=self._operation,
                line=self._line,
                waited_s=self._limit_s,
                hint=self._hint,
            ) from expired

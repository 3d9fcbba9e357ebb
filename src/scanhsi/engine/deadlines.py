"""How long the engine waits for what, and the error it raises then: who was waited for, where, and what was last heard of it.

A driver has deadlines of its own, tighter and better informed. These stand behind them: whatever a driver does, a scan does not
hang.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum, unique
from types import TracebackType

from scanhsi.clock import now_ns
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
CONNECT_S = 30.0
"""Opening a device anew: an Arduino restarts, a camera that lost its controller lets go of it after seconds."""
CLOSE_S = 15.0
"""Closing a device that is gone."""


@unique
class Part(StrEnum):
    """Who is waited for, and whose fault something is."""

    CAMERA = "camera"
    ACTUATOR = "actuator"
    STORAGE = "storage"
    LIGHT = "light"


_HINTS = {
    Part.CAMERA: "power and cable of the camera, and whether another program talks to it.",
    Part.ACTUATOR: "power and cable of the mirror's controller.",
    Part.STORAGE: "whether the disk, or the network to it, answers; the cube can be resumed when it does.",
    Part.LIGHT: "power and cable of the light.",
}


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


class Watch:
    """The watchdogs of one scan: gives every wait its deadline, knows what was heard last of whom and whose fault an error is.

    Args:
        names: How messages call the parts.
    """

    def __init__(self, names: Mapping[Part, str]) -> None:
        self.names = dict(names)
        self._heard: dict[Part, tuple[str, int | None, int]] = {}
        self._blamed: dict[BaseException, Part] = {}

    def __call__(
        self, part: Part, limit_s: float, operation: str, *, line: int | None = None, hint: str | None = None
    ) -> Deadline:
        """``async with watch(Part.CAMERA, limit_s, "expose", line=line)``: see `Deadline`."""
        return Deadline(self, part, limit_s, operation, line, hint or _HINTS[part])

    def heard(self, part: Part, what: str, line: int | None) -> None:
        """All is well with a part: it has just done something."""
        self._heard[part] = what, line, now_ns()

    def last_heard(self, part: Part) -> str:
        """For messages: what a part did last and how long ago that was."""
        if part not in self._heard:
            return "nothing was heard of it before"
        what, line, at_ns = self._heard[part]
        where = "" if line is None else f" of line {line}"
        return f"last heard of it: {what}{where}, {(now_ns() - at_ns) * 1e-9:.3g} s before"

    def blame(self, part: Part, error: BaseException) -> None:
        """Note whose fault an error is."""
        self._blamed.setdefault(error, part)

    def blamed(self, error: BaseException) -> Part | None:
        """Whose fault an error is; None where that is not known."""
        return self._blamed.get(error)

    def forget_faults(self) -> None:
        """They are dealt with; what they hold on to is free."""
        self._blamed.clear()


class Deadline:
    """Like `asyncio.timeout`, but the error tells who was waited for, for what and how long, and what was heard of it last."""

    __slots__ = ("_hint", "_limit_s", "_line", "_operation", "_part", "_timer", "_watch")

    def __init__(
        self, watch: Watch, part: Part, limit_s: float, operation: str, line: int | None, hint: str | None
    ) -> None:
        self._watch = watch
        self._part = part
        self._limit_s = limit_s
        self._operation = operation
        self._line = line
        self._hint = hint
        self._timer = asyncio.timeout(limit_s)

    async def __aenter__(self) -> None:
        await self._timer.__aenter__()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        watch, part = self._watch, self._part
        try:
            await self._timer.__aexit__(kind, error, trace)
        except TimeoutError as expired:
            failure = DeviceTimeout(
                f"it did not end within its deadline; {watch.last_heard(part)}.",
                device=watch.names[part],
                operation=self._operation,
                line=self._line,
                waited_s=self._limit_s,
                hint=self._hint,
            )
            watch.blame(part, failure)
            raise failure from expired
        if error is None:
            watch.heard(part, self._operation, self._line)
        elif isinstance(error, Exception):
            watch.blame(part, error)

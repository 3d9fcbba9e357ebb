"""Which devices of an open instrument were lost, and getting them back."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping
from functools import partial
from typing import Final, get_args

from scanhsi.devices import Sweeps, sensor_temperature_c
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceTimeout, PositionLost, ScanFailed
from scanhsi.engine.deadlines import STOP_S, Part, Watch
from scanhsi.engine.reopening import DeviceRole, reopen
from scanhsi.instrument import Instrument
from scanhsi.instrument.instrument import together
from scanhsi.log import get_logger

_ROLES: Final[tuple[DeviceRole, ...]] = get_args(DeviceRole)
_log = get_logger(__name__)


class LostDevices:
    """Devices that have to be opened anew before they are used again, and what happened to each.

    Args:
        instrument: Whose devices.
    """

    def __init__(self, instrument: Instrument) -> None:
        self._instrument = instrument
        self._why: dict[DeviceRole, str] = {}

    @property
    def why(self) -> dict[DeviceRole, str]:
        """What happened to each."""
        return dict(self._why)

    def note(self, error: BaseException) -> None:
        """See from an error whether a device was lost."""
        lost: dict[DeviceRole, str] = {}
        if isinstance(error, ScanFailed):
            lost = {role: error.lost[role] for role in _ROLES if role in error.lost}
        elif isinstance(error, DeviceLost):
            lost = {role: str(error) for role, name in self._names().items() if name == error.device}
        self._mark(lost)

    async def look(self) -> None:
        """Ask those that can be asked without doing anything whether they are still there: they may have gone unnoticed."""
        camera, actuator = self._instrument.camera, self._instrument.actuator
        questions: dict[DeviceRole, Callable[[], Awaitable[object]]] = {"camera": partial(sensor_temperature_c, camera)}
        if isinstance(actuator, Sweeps):
            questions["actuator"] = actuator.locate
        for role, ask in questions.items():
            if role in self._why:
                continue
            part = Part(role)
            try:
                async with Watch({part: self._names()[role]})(part, STOP_S, "look"):
                    await ask()
            except (DeviceLost, DeviceTimeout) as error:
                self._mark({role: str(error)})
            except DeviceError:
                pass  # it answers: let whoever uses it see to that

    async def reopen(self, roles: Iterable[DeviceRole] | None = None) -> None:
        """Open devices anew, at once; see `scanhsi.engine.reopening.reopen`, also for the errors.

        Args:
            roles: Which; by default those that were lost.
        """
        wanted = tuple(self._why if roles is None else dict.fromkeys(roles))
        if not wanted:
            return
        before = self.why
        self._why |= {
            role: before.get(role, "it was not opened to the end.") for role in wanted
        }  # if this is cancelled
        results = await asyncio.gather(*(reopen(self._instrument, role) for role in wanted), return_exceptions=True)
        for role, result in zip(wanted, results, strict=True):
            if result is None or isinstance(result, PositionLost) or role not in self._names():
                del self._why[role]
            else:
                self._why[role] = str(result)
        if failures := [result for result in results if isinstance(result, Exception)]:
            raise together("were not opened anew", failures)

    def _mark(self, lost: Mapping[DeviceRole, str]) -> None:
        for role, why in lost.items():
            if role not in self._why:
                _log.warning("lost: to be opened anew before it is used again", device=self._names()[role], error=why)
        self._why |= lost

    def _names(self) -> dict[DeviceRole, str]:
        known = self._instrument
        names: dict[DeviceRole, str] = {"camera": known.camera_info.name, "actuator": known.actuator_info.name}
        return names if known.light_info is None else {**names, "light": known.light_info.name}

"""An open instrument: all devices connected, checked against the instrument file, and closed again whatever happens."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Iterable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Final

from scanhsi.devices import (
    Actuator,
    ActuatorInfo,
    Camera,
    CameraInfo,
    CameraSettings,
    Light,
    LightInfo,
    Range,
    ShowsScenes,
    check_settings,
)
from scanhsi.devices.errors import ConfigError, DeviceError, DeviceTimeout
from scanhsi.instrument.config import InstrumentConfig
from scanhsi.log import get_logger

_CONNECT_S: Final = 30.0
_CLOSE_S: Final = 15.0
_log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Instrument:
    """The devices of one instrument, connected.

    Attributes:
        config: Its file.
        camera, actuator: The devices, as their drivers made them.
        camera_info, actuator_info: What they are and allow, narrowed by the file's ``[limits]``: check plans against these.
        light, light_info: What illuminates the object, where the file has a ``[light]``; None where nothing can be switched.
    """

    config: InstrumentConfig
    camera: Camera
    actuator: Actuator
    camera_info: CameraInfo
    actuator_info: ActuatorInfo
    light: Light | None = None
    light_info: LightInfo | None = None

    @property
    def simulated(self) -> bool:
        """Whether any device is not a real one."""
        infos = (self.camera_info, self.actuator_info, self.light_info)
        return any(info.simulated for info in infos if info is not None)

    @staticmethod
    @asynccontextmanager
    async def open(config: InstrumentConfig) -> AsyncGenerator[Instrument]:
        """Connect all devices at once; close them on leaving, light and actuator first, each whatever became of the others.

        Raises:
            DeviceError: A device cannot be made or connected (all failures in one message), or did not close although all
                else went well.
            ConfigError: What the devices turned out to be contradicts the file.
        """
        camera, actuator = config.camera.create(), config.actuator.create()
        light = config.light.create() if config.light else None
        devices: dict[str, Camera | Actuator | Light] = {
            f"camera {config.camera.driver}": camera,
            f"actuator {config.actuator.driver}": actuator,
        }
        if config.light is not None and light is not None:
            devices[f"light {config.light.driver}"] = light
        failures: list[Exception] = []
        try:
            async with AsyncExitStack() as stack:
                for name, device in devices.items():
                    stack.push_async_callback(_close, device, name, failures)
                await _connect_all(devices)
                checked = _checked(config, camera, actuator)
                yield replace(checked, light=light, light_info=light.info if light else None)
        except BaseException as error:
            for failure in failures:
                error.add_note(f"while closing: {failure}")
            raise
        if failures:
            raise together("did not close", failures)

    def check(self, settings: CameraSettings, steps: Iterable[int]) -> CameraSettings:
        """Refuse what devices or ``[limits]`` do not allow, before anything moves; return the settings with the ROI filled in.

        Args:
            settings: Of the camera.
            steps: Mirror positions that are going to be visited; their extremes are enough.

        Raises:
            OutOfRange: Tells the value and what is allowed.
        """
        for step in steps:
            self.actuator_info.limits.check(
                "position",
                step,
                device=self.actuator_info.name,
                hint="fewer lines, smaller steps, or another start",
            )
        return check_settings(self.camera_info, settings)

    def describe(self) -> dict[str, Any]:
        """What the instrument is, as plain JSON types: for ``--json``, logs and the cube."""
        described = {
            "name": self.config.name,
            "description": self.config.description,
            "simulated": self.simulated,
            "camera": {"driver": self.config.camera.driver, **_plain(self.camera_info), **self._scene()},
            "actuator": {"driver": self.config.actuator.driver, **_plain(self.actuator_info)},
        }
        if self.config.light is not None:
            described["light"] = {"driver": self.config.light.driver, **_plain(self.light_info)}
        return described

    def _scene(self) -> dict[str, Any]:
        """What a simulated camera looks at now: another scene than the file's may have been put before it."""
        return {"scene": self.camera.scene} if isinstance(self.camera, ShowsScenes) else {}


async def _connect_all(devices: Mapping[str, Camera | Actuator | Light]) -> None:
    failures: list[Exception] = []
    async with (
        asyncio.TaskGroup() as group
    ):  # a failure is collected, not raised: the other devices get their own answers
        for name, device in devices.items():
            group.create_task(_connect(device, name, failures))
    if failures:
        raise together("did not connect", failures)


async def _connect(device: Camera | Actuator | Light, name: str, failures: list[Exception]) -> None:
    deadline = asyncio.timeout(_CONNECT_S)
    try:
        async with deadline:
            await device.connect()
        _log.info("connected", device=device.info.name, operation="connect")
    except Exception as error:
        timed_out = isinstance(error, TimeoutError) and deadline.expired()
        failures.append(_timeout(name, "connect", _CONNECT_S) if timed_out else error)


async def _close(device: Camera | Actuator | Light, name: str, failures: list[Exception]) -> None:
    """Close within the deadline, in a task that no cancellation reaches: a second Ctrl-C must not leave a device half open."""
    task = asyncio.ensure_future(_close_in_time(device, name, failures))
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError as error:
            cancelled = error
    task.result()
    if cancelled is not None:
        raise cancelled


async def _close_in_time(device: Camera | Actuator | Light, name: str, failures: list[Exception]) -> None:
    deadline = asyncio.timeout(_CLOSE_S)
    try:
        async with deadline:
            await device.close()
    except Exception as error:  # collected: the other devices are closed all the same
        timed_out = isinstance(error, TimeoutError) and deadline.expired()
        failures.append(_timeout(name, "close", _CLOSE_S) if timed_out else error)
        _log.warning("did not close", device=name, operation="close", error=str(failures[-1]))


def _timeout(name: str, operation: str, waited_s: float) -> DeviceTimeout:
    return DeviceTimeout("no answer.", device=name, operation=operation, waited_s=waited_s)


def together(what: str, failures: list[Exception]) -> Exception:
    """One error for one failure, itself; for several, one that lists them all."""
    if len(failures) == 1:
        return failures[0]
    lines = [f"{type(failure).__name__}: {failure}" for failure in failures]
    error = DeviceError("\n  - ".join([f"{len(failures)} devices {what}:", *lines]))
    error.__cause__ = ExceptionGroup(what, failures)
    return error


def _checked(config: InstrumentConfig, camera: Camera, actuator: Actuator) -> Instrument:
    """The instrument with its limits narrowed, or all contradictions between file and devices at once."""
    problems: list[str] = []
    limits = config.limits
    camera_info, actuator_info = camera.info, actuator.info
    here, there = config.geometry.steps_per_revolution, actuator_info.steps_per_revolution
    if here != there:
        problems.append(f"geometry.steps_per_revolution = {here}: {actuator_info.name} has {there}")
    if config.roi is not None:
        problems += _roi_problems(config, camera_info)
    exposure = _narrowed("limits.exposure", camera_info.exposure, limits.exposure_s, camera_info.name, problems)
    gain = _narrowed("limits.gain", camera_info.gain, limits.gain_db, camera_info.name, problems)
    steps = _narrowed("limits.steps", actuator_info.limits, limits.steps, actuator_info.name, problems)
    if problems:
        raise ConfigError(f"instrument {config.name} does not fit its devices:", problems)
    return Instrument(
        config,
        camera,
        actuator,
        replace(camera_info, exposure=exposure, gain=gain),
        replace(actuator_info, limits=steps),
    )


def _roi_problems(config: InstrumentConfig, info: CameraInfo) -> list[str]:
    assert config.roi is not None
    roi = config.roi
    ends = (
        ("samples", roi.sample_offset + roi.samples, info.samples),
        ("bands", roi.band_offset + roi.bands, info.bands),
    )
    return [f"roi: {word} end at {end}, the sensor of {info.name} has {size}" for word, end, size in ends if end > size]


def _narrowed(key: str, allowed: Range, asked: tuple[float, float] | None, device: str, problems: list[str]) -> Range:
    if asked is None:
        return allowed
    if asked[0] < allowed.minimum or asked[1] > allowed.maximum:
        unit = f" {allowed.unit}" if allowed.unit else ""
        problems.append(f"{key} = [{asked[0]:g}, {asked[1]:g}]{unit}: {device} allows {allowed}")
        return allowed
    if not allowed.step:
        return replace(allowed, minimum=asked[0], maximum=asked[1])
    steps = math.ceil((asked[0] - allowed.minimum) / allowed.step - 1e-6)  # stay on the device's own grid
    return replace(allowed, minimum=allowed.minimum + steps * allowed.step, maximum=asked[1])


def _plain(value: Any) -> Any:
    """As JSON can hold it: limits that are infinite become null."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, frozenset | tuple | list):
        items = [_plain(item) for item in value]  # pyright: ignore[reportUnknownVariableType] whatever an info holds
        return sorted(items) if isinstance(value, frozenset) else items
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, str) else value

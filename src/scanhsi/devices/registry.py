"""Backends: how a driver makes itself known, and how they are found.

A driver package declares an entry point in the group ``scanhsi.cameras``, ``scanhsi.actuators`` or ``scanhsi.lights`` whose name is
the word that an instrument file uses (``driver = "aravis"``) and whose value is a `Backend`::

    [project.entry-points."scanhsi.cameras"]
    mycam = "my_package:backend"

That is all: scanhsi's own drivers use the same door.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum, unique
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from scanhsi.devices.actuator import Actuator
from scanhsi.devices.camera import Camera
from scanhsi.devices.capabilities import capabilities_of
from scanhsi.devices.errors import ConfigError, DeviceUnavailable
from scanhsi.devices.light import Light

D = TypeVar("D", Camera, Actuator, Light)


@unique
class Role(StrEnum):
    """What a device is to the instrument; the value is the group of its entry points."""

    CAMERA = "scanhsi.cameras"
    ACTUATOR = "scanhsi.actuators"
    LIGHT = "scanhsi.lights"

    @property
    def word(self) -> str:
        """``"camera"``, ``"actuator"`` or ``"light"``: the table of an instrument file."""
        return self.name.lower()


def always_available() -> str | None:
    """The ``missing`` of a backend that needs nothing beyond scanhsi."""
    return None


@dataclass(frozen=True, slots=True)
class Backend(Generic[D]):
    """One driver, as its entry point offers it. Importing it must not import a hardware library.

    Attributes:
        summary: One line for ``scanhsi drivers``.
        options: Frozen pydantic model (``extra="forbid"``) of what an instrument file may say beside ``driver``; each field has
            a description.
        device: The class, from which the optional abilities are read.
        create: Makes the device from its options; opens nothing (that is ``connect``).
        missing: Returns what is missing on this computer and how to get it, or None when the driver can be used.
        virtual_time: Whether the device runs in virtual time, too: it waits through asyncio only and talks to nothing outside.
        timing: Tells from the options, without a device, what its delays are, as a `scanhsi.timing.devices.DeviceTiming` (typed
            loosely, for contracts know nothing of timing); None for a driver that cannot know them.
    """

    summary: str
    options: type[BaseModel]
    device: type[D]
    create: Callable[[Any], D]
    missing: Callable[[], str | None] = always_available
    virtual_time: bool = False
    timing: Callable[[Any], object] | None = None

    @property
    def capabilities(self) -> tuple[str, ...]:
        """Names of the optional abilities."""
        return capabilities_of(self.device)


@dataclass(frozen=True, slots=True)
class Found:
    """One entry point: a backend, or why it could not be loaded.

    Attributes:
        name: Name of the driver in instrument files.
        role: Camera, actuator or light.
        package: Distribution that installed it.
        backend: The backend, or None.
        problem: Why it cannot be used on this computer, or None.
    """

    name: str
    role: Role
    package: str
    backend: Backend[Any] | None
    problem: str | None


def installed(role: Role) -> list[Found]:
    """Every installed backend of a role, also those that cannot be loaded, by name."""
    _points.cache_clear()
    return sorted((_load(role, point) for point in _points(role)), key=lambda found: found.name)


def find(role: Role, name: str) -> Backend[Any]:
    """The backend of that name.

    Raises:
        ConfigError: No such driver is installed; the message lists those that are.
        DeviceUnavailable: It is installed and cannot be loaded here.
    """
    if all(point.name != name for point in _points(role)):
        _points.cache_clear()  # it may have been installed since
    known = {point.name: point for point in _points(role)}
    if name not in known:
        raise ConfigError(
            f"there is no {role.word} driver {name!r}; installed are: {', '.join(sorted(known)) or 'none'}.",
            hint="`scanhsi drivers` lists them with what each can do.",
        )
    found = _load(role, known[name])
    if found.backend is None:
        raise DeviceUnavailable(f"driver {name!r} of {found.package} cannot be loaded: {found.problem}", device=name)
    return found.backend


@cache
def _points(role: Role) -> tuple[EntryPoint, ...]:
    """Looked up once: to go through all that is installed takes longer than to open a simulated instrument."""
    return tuple(entry_points(group=role.value))


def _load(role: Role, point: EntryPoint) -> Found:
    package = point.dist.name if point.dist else "unknown"
    try:
        backend = point.load()
    except Exception as error:  # a broken third-party driver must not take the others down
        return Found(point.name, role, package, None, f"{type(error).__name__}: {error}")
    if not isinstance(backend, Backend):
        return Found(point.name, role, package, None, f"{point.value} is not a scanhsi Backend")
    return Found(point.name, role, package, backend, backend.missing())  # pyright: ignore[reportUnknownArgumentType]

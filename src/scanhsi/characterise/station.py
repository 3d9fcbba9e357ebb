"""What a protocol works with: an instrument, somebody who puts things before it, and a folder for what was seen."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from scanhsi.devices import Camera, ShowsScenes
from scanhsi.devices.errors import CalibrationError, CubeExists
from scanhsi.engine import Progress, ScanPlan, ScanReport
from scanhsi.instrument import Instrument


class Scans(Protocol):
    """What protocols need of `scanhsi.Imager`."""

    @property
    def instrument(self) -> Instrument:
        """Its devices, with their limits."""
        ...

    @property
    def camera(self) -> Camera:
        """Its camera."""
        ...

    def default_plan(self, **overrides: Any) -> ScanPlan:
        """The plan of the instrument file with some fields set otherwise."""
        ...

    async def scan(
        self,
        plan: ScanPlan,
        output: str | Path | None,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        target: str | None = None,
    ) -> ScanReport:
        """Scan."""
        ...


@dataclass(frozen=True, slots=True)
class Target:
    """Something to put before the instrument.

    Attributes:
        name: In cubes and messages, and of the simulated scene.
        request: What a person is asked to do.
    """

    name: str
    request: str


DARK: Final = Target("dark", "Close the shutter, or put the cap on the lens.")
WHITE: Final = Target("white", "Put the white tile before the instrument, evenly lit.")
GRID: Final = Target(
    "amsler", "Put the grid in the object plane, a line of it under the middle, its lines along slit and scan."
)
SLANTED_LINES: Final = Target("slanted-lines", "Put the slanted lines in the object plane.")
SLANTED_EDGE: Final = Target("slanted-edge", "Put the white square in the object plane, turned by 5 degrees.")
TILE: Final = Target("wavelength-tile", "Put the wavelength standard where the white tile was, in the same light.")
LAMP: Final = Target("hgar", "Light the slit, all of it, with the spectral lamp.")

Prompt = Callable[[Target], Awaitable[None]]
"""Asks a person to put something before the instrument; returns when that is done."""

Tell = Callable[[str], None]
"""Told what is being done, a few words at a time."""


@dataclass(frozen=True, slots=True)
class Station:
    """One protocol under way; made by `station`.

    Attributes:
        imager: What it takes cubes with.
        folder: Where they go.
        prompt: Asks a person; None: only simulated instruments know what to do.
        tell: Told what is being done.
    """

    imager: Scans
    folder: Path
    prompt: Prompt | None
    tell: Tell

    async def look_at(self, target: Target) -> None:
        """Have something before the instrument: a simulated one is shown it, before a real one a person puts it.

        Raises:
            CalibrationError: There is nobody to ask.
        """
        camera = self.imager.camera
        if isinstance(camera, ShowsScenes) and target.name in camera.scenes:
            await camera.show(target.name)
        elif self.prompt is not None:
            await self.prompt(target)
        else:
            raise CalibrationError(
                f"somebody has to act: {target.request}",
                hint="hsi.calibrate.asking(prompt), with an async function that asks for it",
            )

    async def still(self, name: str, target: Target, *, exposure_s: float, frames: int) -> Path:
        """Take frames with the mirror at rest, straight ahead; return the cube.

        Raises:
            ScanFailed, OutOfRange: As scans do.
            CalibrationError: Lines were lost.
        """
        config = self.imager.instrument.config
        plan = self.imager.default_plan(
            lines=frames,
            step=0,
            start=config.geometry.normal_step,
            exposure_s=exposure_s,
            mode="stepped",
            look_ahead=None,
        )
        return await self.take(name, target, plan)

    async def take(self, name: str, target: Target, plan: ScanPlan) -> Path:
        """Take a cube; return its path."""
        path = self.folder / f"{name}.zarr"
        self.tell(f"{target.name}, {plan.lines} lines of {1000 * plan.exposure_s:g} ms")
        report = await self.imager.scan(plan, path, target=target.name)
        if report.missing:
            raise CalibrationError(f"{report.missing} lines of {path} were lost.", hint="take it again")
        return path


@asynccontextmanager
async def station(
    imager: Scans, folder: Path | None, *, prompt: Prompt | None = None, tell: Tell | None = None
) -> AsyncGenerator[Station]:
    """Prepare a protocol; afterwards a simulated camera looks at what it looked at before.

    Args:
        imager: The instrument.
        folder: Where cubes are kept; it must not exist. None: they are thrown away in the end.
        prompt: Asks a person.
        tell: Told what is being done.

    Raises:
        CubeExists: The folder is there already.
    """
    if folder is not None:
        _create(folder)
    camera = imager.camera
    before = camera.scene if isinstance(camera, ShowsScenes) else None
    with tempfile.TemporaryDirectory(prefix="scanhsi-") as temporary:
        try:
            yield Station(imager, folder or Path(temporary), prompt, tell or _say_nothing)
        finally:
            if before is not None and isinstance(camera, ShowsScenes):
                await camera.show(before)


def _create(folder: Path) -> None:
    if folder.exists():
        raise CubeExists(f"{folder} is there already, with the cubes of an earlier run.", hint="another name")
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise CalibrationError(f"cannot create {folder}: {error.strerror or error}.") from error


def _say_nothing(text: str) -> None:
    del text

"""Both twins as one instrument: the camera shows what the stepper's mirror shows, the stepper's trigger fires the camera."""

import shutil
import tempfile
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from scanhsi_sim.twins import netns
from scanhsi_sim.twins.camera_twin import CameraTwin, CameraTwinSettings
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings


@dataclass(slots=True)
class TwinRig:
    """The instrument's twins, running inside ``async with``; needs a private network namespace.

    Attributes:
        scene: What the camera looks at: a name of `scanhsi_sim.scenes.SCENES`.
        seed: Of the scene and of the camera's noise.
        settings: Of the stepper; its trigger socket is set here.
    """

    scene: str = "testpattern"
    seed: int = 0
    settings: StepperTwinSettings = field(default_factory=StepperTwinSettings)
    _camera: CameraTwin | None = None
    _stepper: StepperTwin | None = None
    _stack: AsyncExitStack = field(default_factory=AsyncExitStack)

    @property
    def camera(self) -> CameraTwin:
        """The camera's twin: commands, counters, pid."""
        if self._camera is None:
            raise RuntimeError("the twins are not running: use the rig in `async with`")
        return self._camera

    @property
    def stepper(self) -> StepperTwin:
        """The stepper's twin: commands, counters, pid, the mirror's true position."""
        if self._stepper is None:
            raise RuntimeError("the twins are not running: use the rig in `async with`")
        return self._stepper

    @property
    def camera_address(self) -> str:
        """Where the GigE Vision camera answers."""
        return self.camera.address

    @property
    def port(self) -> str:
        """Path to open as the stepper's serial port."""
        return self.stepper.port

    async def __aenter__(self) -> Self:
        netns.require_private_network()
        async with AsyncExitStack() as stack:
            folder = Path(tempfile.mkdtemp(prefix="scanhsi-rig-"))
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            trigger = folder / "trigger"
            stepper = StepperTwin(replace(self.settings, trigger_socket=trigger))
            self._stepper = await stack.enter_async_context(stepper)
            settings = CameraTwinSettings(
                scene=self.scene, seed=self.seed, mirror_file=stepper.mirror_file, trigger_socket=trigger
            )
            self._camera = await stack.enter_async_context(CameraTwin(settings))
            self._stack = stack.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stack.aclose()
        self._camera = self._stepper = None

"""The Python interface of an instrument, over HTTP."""

from __future__ import annotations

import asyncio
import contextlib
import getpass
import socket
import tempfile
import zipfile
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, cast

import httpx
from pydantic import TypeAdapter

from scanhsi.calibration.kinds import load_any
from scanhsi.calibration.result import Result
from scanhsi.client import sockets
from scanhsi.client.errors import error_of
from scanhsi.client.transport import Transport, connected
from scanhsi.cube.exchange.output import refuse_existing
from scanhsi.devices.errors import CalibrationError, ScanhsiError
from scanhsi.engine import Progress, ScanControl, ScanPlan, ScanReport
from scanhsi.engine.reopening import DeviceRole
from scanhsi.imager import default_plan
from scanhsi.instrument import InstrumentConfig

_REPORT: Final = TypeAdapter(ScanReport)
_TOLD_S: Final = 0.25
_WAIT_S: Final = 20.0

Prompt = Callable[[str], Awaitable[None]]


@asynccontextmanager
async def connect_instrument(
    url: str,
    *,
    token: str | None = None,
    name: str | None = None,
    download: bool = True,
    certificate: str | Path | None = None,
    transport: httpx.AsyncBaseTransport | None = None,
) -> AsyncGenerator[AsyncClient]:
    """Connect to a service; control is taken with the first command, and given up on leaving.

    Args:
        url: Where it listens: ``http://127.0.0.1:8080``.
        token: Its token, where it has one. Not in the URL.
        name: How others see who is in control; user and computer by default.
        download: Bring the cube of a scan to its path. Otherwise it stays at the instrument, under its name.
        certificate: The service's own TLS certificate, PEM, where no authority has signed it that this computer knows.
        transport: For tests: instead of the network.

    Raises:
        DeviceNotFound: Nothing answers there.
        ConfigError: The certificate cannot be read.
        ScanhsiError: The token is missing or wrong.
    """
    name = name or f"{getpass.getuser()} on {socket.gethostname()}"
    async with connected(url, token, name[:80], certificate, transport) as opened:
        capabilities = await opened.get("/capabilities")
        state = await opened.get("/state")
        config = InstrumentConfig.model_validate(capabilities["config"])
        yield AsyncClient(opened, config, capabilities, state, token, download=download)


class AsyncClient:
    """A remote instrument; made by `connect_instrument`. As `scanhsi.Imager`, where the names are the same.

    Attributes:
        config: Its instrument file.
        capabilities: What it is and allows.
        simulated: Whether any of its devices is not a real one.
        run: Identifies its opening in logs and cubes.
        camera: Settings and live view.
        actuator: The mirror.
    """

    def __init__(
        self,
        transport: Transport,
        config: InstrumentConfig,
        capabilities: dict[str, Any],
        state: dict[str, Any],
        token: str | None,
        *,
        download: bool,
    ) -> None:
        self.config = config
        self.capabilities = capabilities
        self.simulated = bool(capabilities["simulated"])
        self.run = str(state["run"])
        self.camera = RemoteCamera(transport)
        self.actuator = RemoteMirror(transport, state["mirror"])
        self._transport = transport
        self._token = token
        self._download = download

    @property
    def calibrate(self) -> RemoteCalibrator:
        """Protocols that characterise the instrument: ``await hsi.calibrate.run("dark", "dark.nc")``."""
        return RemoteCalibrator(self._transport)

    def default_plan(self, **overrides: Any) -> ScanPlan:
        """The plan of the instrument file's ``[scan]`` table, with some fields set otherwise."""
        return default_plan(self.config, **overrides)

    async def state(self) -> dict[str, Any]:
        """How things stand."""
        return await self._transport.get("/state")

    async def reopen(self, *devices: DeviceRole) -> None:
        """Open devices anew, by default those that were lost (``(await hsi.state())["lost"]``); see `scanhsi.Imager.reopen`.

        Args:
            devices: ``"camera"``, ``"actuator"``, ``"light"``.

        Raises:
            DeviceError: As `scanhsi.Imager.reopen`.
        """
        await self._transport.command("POST", "/devices/reopen", {"devices": devices})

    async def check(self, plan: ScanPlan) -> dict[str, Any]:
        """What a plan will cost and show; nothing moves.

        Raises:
            OutOfRange, ConfigError: It is not possible here.
        """
        return await self._transport.command("POST", "/plan", _sent(plan), control=False)

    async def scan(
        self,
        plan: ScanPlan,
        output: str | Path | None,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        stop: asyncio.Event | None = None,
        control: ScanControl | None = None,
        target: str | None = None,
    ) -> ScanReport:
        """Scan; see `scanhsi.Imager.scan`. The cube is taken at the instrument, then brought here.

        Args:
            plan: What to scan.
            output: Path of the cube to create here; at the instrument it has the same name. None discards the lines.
            on_progress: Called a few times a second, in the event loop.
            stop: Set it to finish the line under way and close the cube.
            control: Instead of ``stop``: pauses the scan, too.
            target: What is before the instrument; kept in the cube.

        Raises:
            OutOfRange, UnsupportedFeature, ConfigError, CubeExists: Refused; nothing moved.
            DeviceBusy: Somebody else is in control, or a job is under way.
            ScanFailed: It began and did not end well; what was stored is safe, at the instrument.
        """
        path = None if output is None else Path(output)
        if path is not None and self._download:
            refuse_existing(path)
        body = {
            "plan": _sent(plan),
            "output": None if path is None else path.name,
            "discard": path is None,
            "target": target,
        }
        job = await self._transport.command("POST", "/scans", body)
        control = control or ScanControl(**({} if stop is None else {"stop": stop}))
        steering = asyncio.ensure_future(self._steer(job["id"], control))
        try:
            job = await self._over(job["id"], on_progress)
        finally:
            steering.cancel()
            await asyncio.gather(steering, return_exceptions=True)
        report = _REPORT.validate_python(_result(job))
        if path is None:
            return report
        if self._download:
            await self.download(path.name, path)
            return replace(report, output=str(path))
        return report

    async def stop(self) -> None:
        """STOP: the mirror, and whatever would move it again. Needs no control."""
        await self.actuator.stop()

    async def cubes(self) -> list[dict[str, Any]]:
        """Cubes at the instrument, the youngest first."""
        return await self._transport.get("/cubes")

    async def download(self, cube: str, output: str | Path) -> Path:
        """Bring a cube here.

        Args:
            cube: Its name at the instrument.
            output: Folder to create.

        Raises:
            CubeExists: It is there already.
            ScanhsiError: There is no such cube; the connection broke. Nothing is left behind.
        """
        output = Path(output)
        refuse_existing(output)
        with tempfile.TemporaryDirectory(prefix=".scanhsi-", dir=output.parent) as folder:
            await self._transport.fetch(f"/cubes/{cube}/download", Path(folder) / "cube.zip", format="zarr")
            unpacked = Path(folder) / "cube"
            await asyncio.to_thread(_unpack, Path(folder) / "cube.zip", unpacked)
            unpacked.rename(output)
        return output

    def events(self) -> AsyncGenerator[sockets.Happened]:
        """What happens, from now on."""
        return sockets.events(self._url, self._token, self._transport.tls)

    def preview(self, fps: float = 15.0) -> AsyncGenerator[sockets.SeenFrame]:
        """What is seen, the latest only."""
        return sockets.preview(self._url, self._token, fps, self._transport.tls)

    @property
    def _url(self) -> str:
        return str(self._transport.http.base_url).rstrip("/")

    async def _over(self, id: str, on_progress: Callable[[Progress], None] | None) -> dict[str, Any]:
        """The job once it is over; cancelled with whoever waits for it."""
        told: dict[str, Any] | None = None
        try:
            while True:
                wait_s = _WAIT_S if on_progress is None else _TOLD_S
                job = await self._transport.get(f"/jobs/{id}", wait_s=wait_s)
                if on_progress is not None and job["progress"] is not None and job["progress"] != told:
                    told = job["progress"]
                    on_progress(_progress(job["progress"]))
                if job["ended"] is not None:
                    return job
        except asyncio.CancelledError:
            with contextlib.suppress(ScanhsiError):
                await self._transport.command("POST", f"/jobs/{id}/cancel")
            raise

    async def _steer(self, id: str, control: ScanControl) -> None:
        """Pass on what is asked of the scan."""
        while True:
            await control.until_halted()
            if control.stop.is_set():
                await self._transport.command("POST", f"/jobs/{id}/finish")
                return
            await self._transport.command("POST", f"/jobs/{id}/pause")
            await control.until_going()
            if not control.stop.is_set():
                await self._transport.command("POST", f"/jobs/{id}/resume")


@dataclass(slots=True)
class RemoteMirror:
    """The mirror of a remote instrument."""

    _transport: Transport
    _state: dict[str, Any]

    @property
    def position(self) -> int | None:
        """As last heard of."""
        return self._state["step"]

    @property
    def homed(self) -> bool:
        """Whether steps mean angles, as last heard of."""
        return bool(self._state["homed"])

    async def home(self) -> int | None:
        """Find the home position; the position is returned.

        Raises:
            DeviceError: As the actuator does.
        """
        return await self._told("POST", "/mirror/home", None)

    async def move_to(self, step: int) -> int | None:
        """Move to a step; the position is returned.

        Raises:
            OutOfRange: Beyond the limits; nothing moved.
            DeviceError: As the actuator does.
        """
        return await self._told("POST", "/mirror/goto", {"step": step})

    async def stop(self) -> None:
        """STOP. Needs no control."""
        self._state = await self._transport.command("POST", "/stop", control=False)

    async def _told(self, method: str, path: str, body: Any) -> int | None:
        self._state = await self._transport.command(method, path, body)
        return self.position


@dataclass(frozen=True, slots=True)
class RemoteCamera:
    """The camera of a remote instrument."""

    _transport: Transport

    async def configure(
        self, *, exposure_s: float | None = None, gain_db: float | None = None, pixel_format: str | None = None
    ) -> dict[str, Any]:
        """Change settings: of the live view, and of scans that say nothing else. All settings are returned.

        Raises:
            OutOfRange: The camera does not allow one; nothing changed.
        """
        given = {"exposure_s": exposure_s, "gain_db": gain_db, "pixel_format": pixel_format}
        body = {key: value for key, value in given.items() if value is not None}
        return await self._transport.command("PATCH", "/camera", body)

    async def live(self, on: bool) -> None:
        """Switch the live view on or off; see `AsyncClient.preview`."""
        await self._transport.command("PUT", "/live", {"on": on})

    async def show(self, scene: str) -> None:
        """Put something else before a simulated camera."""
        await self._transport.command("PUT", "/scene", {"scene": scene})


@dataclass(frozen=True, slots=True)
class RemoteCalibrator:
    """Protocols of a remote instrument.

    Attributes:
        prompt: Asks a person to put something before it; returns when that is done.
    """

    _transport: Transport
    prompt: Prompt | None = None

    def asking(self, prompt: Prompt | None) -> RemoteCalibrator:
        """The same with somebody to ask."""
        return replace(self, prompt=prompt)

    async def run(self, kind: str, output: str | Path, **options: Any) -> Result:
        """Take what a calibration needs, work it out; the result is saved here, and stays at the instrument, too.

        Args:
            kind: One of ``capabilities["calibrations"]``.
            output: File of the result.
            options: ``frames``, ``exposure_s``.

        Raises:
            CalibrationError: There is nobody to ask; or as the protocol does.
            CubeExists: The file is there already.
        """
        path = Path(output)
        refuse_existing(path)
        body = {"kind": kind, "output": path.name, **options}
        job = await self._transport.command("POST", "/calibrations", body)
        try:
            while job["ended"] is None:
                if job["state"] == "waiting":
                    await self._ask(job)
                job = await self._transport.get(f"/jobs/{job['id']}", wait_s=1.0)
        except BaseException:
            with contextlib.suppress(ScanhsiError):
                await self._transport.command("POST", f"/jobs/{job['id']}/cancel")
            raise
        _result(job)
        await self._transport.fetch(f"/calibrations/{job['output']}/file", path)
        return await asyncio.to_thread(load_any, path)

    async def _ask(self, job: dict[str, Any]) -> None:
        if self.prompt is None:
            raise CalibrationError(f"somebody has to act: {job['prompt']}", hint="hsi.calibrate.asking(prompt)")
        await self.prompt(str(job["prompt"]))
        await self._transport.command("POST", f"/jobs/{job['id']}/confirm")


def _sent(plan: ScanPlan) -> dict[str, Any]:
    """A plan as the service takes it."""
    return plan.model_dump(mode="json")


def _result(job: dict[str, Any]) -> dict[str, Any]:
    """What came of a job.

    Raises:
        ScanhsiError: It failed, or was cancelled by somebody else.
    """
    if job["problem"] is not None:
        raise error_of(job["problem"])
    if job["result"] is None:
        raise ScanhsiError(f"{job['title']} was {job['state']} by somebody else.")
    return cast("dict[str, Any]", job["result"])


def _progress(told: dict[str, Any]) -> Progress:
    known = {field.name for field in fields(Progress)}
    values: dict[str, Any] = {key: told[key] for key in known & told.keys()}
    remaining_s = values.pop("remaining_s", None)
    return Progress(**values, remaining_s=float("nan") if remaining_s is None else remaining_s)


def _unpack(archive: Path, folder: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(folder)

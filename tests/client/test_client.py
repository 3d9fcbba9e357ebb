"""A script moves from a local instrument to a remote one by changing one line."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

import scanhsi
from scanhsi.calibration.dark import DarkModel
from scanhsi.client import AsyncClient, connect_instrument
from scanhsi.client.errors import error_of
from scanhsi.clock import run_virtual
from scanhsi.devices import errors
from scanhsi.devices.errors import CubeExists, DeviceBusy, DeviceNotFound, OutOfRange, ScanFailed
from scanhsi.engine import ScanControl, ScanPlan
from scanhsi.service.models import PlanBody
from scanhsi.service.problems import problem_of
from scanhsi.service.security import Security
from support.service import Service, open_service, small

OPEN = Security(requests_s=1e6, burst=1e6)


@asynccontextmanager
async def remote(
    folder: Path, *, download: bool = True, security: Security = OPEN, **settings: Any
) -> AsyncGenerator[tuple[AsyncClient, Service]]:
    async with open_service(folder, small(**settings), security) as service:
        transport = httpx.ASGITransport(app=service.app)
        async with connect_instrument("http://localhost", name="Ada", download=download, transport=transport) as hsi:
            yield hsi, service


def run(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def test_the_script_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Word for word, but for the line that opens the instrument; the same cube, bit for bit."""
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    code = next(block for block in re.findall(r"```python\n(.*?)```", readme, re.DOTALL) if "open_instrument" in block)
    opening = re.search(r"scanhsi\.open_instrument\([^)]*\)", code)
    assert opening is not None
    cubes: list[Any] = []
    reports: list[str] = []
    for where, line in (
        ("local", "scanhsi.open_instrument(local)"),
        ("remote", "connect_instrument('http://localhost', transport=transport)"),
    ):
        here = tmp_path / where
        here.mkdir()
        monkeypatch.chdir(here)
        script = code.replace(opening[0], line).replace("lines=300", "lines=60")
        body, _, _ = script.partition("asyncio.run(")
        names: dict[str, Any] = {"local": small(), "connect_instrument": connect_instrument}
        names["print"] = lambda *words: reports.append(str(len(words)))

        async def main(where: str = where, body: str = body, names: dict[str, Any] = names) -> None:
            exec(body, names)
            if where == "local":
                await names["main"]()
                return
            async with open_service(tmp_path / "data", small(), OPEN) as service:
                names["transport"] = httpx.ASGITransport(app=service.app)
                await names["main"]()

        run_virtual(main())
        cubes.append(scanhsi.open_cube(here / "hand.zarr", chunks=None).load())
    assert reports == ["2", "2"]
    ours, theirs = cubes
    assert (ours["cube"].values == theirs["cube"].values).all()
    assert (ours["mirror_step"].values == theirs["mirror_step"].values).all()
    assert ours["cube"].dtype == theirs["cube"].dtype
    assert theirs.attrs["simulated"] is True


def test_the_report_progress_and_settings(tmp_path: Path) -> None:
    async def main() -> None:
        told: list[scanhsi.Progress] = []
        async with remote(tmp_path / "data") as (hsi, _):
            assert hsi.simulated
            assert hsi.default_plan() == ScanPlan.model_validate(hsi.capabilities["default_plan"])
            plan = hsi.default_plan(lines=60, exposure="30 ms", mode="sequential")
            assert (await hsi.check(plan))["time"]["scan_s"] > 60 * 0.03
            report = await hsi.scan(plan, tmp_path / "a.zarr", on_progress=told.append, target="leaf")
            assert (report.mode, report.stored, report.exposure_s) == ("sequential", 60, 0.03)
            assert report.output == str(tmp_path / "a.zarr")
            assert report.stages["exposure"].mean_s == pytest.approx(0.03)
            assert report.real_time is not None
            assert len(told) > 3
            assert told[-1].taken == 60
            with pytest.raises(CubeExists):
                await hsi.scan(plan, tmp_path / "a.zarr")
            assert (await hsi.scan(plan, None)).output is None
            with pytest.raises(OutOfRange, match="allowed"):
                await hsi.scan(hsi.default_plan(exposure="9 s"), None)
            assert await hsi.actuator.home() == 0
            assert await hsi.actuator.move_to(40) == hsi.actuator.position == 40
            with pytest.raises(OutOfRange):
                await hsi.actuator.move_to(10**7)
            await hsi.stop()
            assert (await hsi.camera.configure(gain_db=3.0))["gain_db"] == 3.0
            assert [cube["target"] for cube in await hsi.cubes()] == ["leaf"]

    run(main())
    assert scanhsi.open_cube(tmp_path / "a.zarr").attrs["target"] == "leaf"


def test_scans_are_paused_finished_and_cancelled_from_afar(tmp_path: Path) -> None:
    async def main() -> None:
        async with remote(tmp_path / "data", download=False) as (hsi, service):
            control = ScanControl()
            scan = asyncio.ensure_future(hsi.scan(hsi.default_plan(lines=300), "a.zarr", control=control))
            await asyncio.sleep(2)
            control.pause()
            await asyncio.sleep(1)
            assert service.station.jobs.all()[0].state == "paused"
            control.go_on()
            await asyncio.sleep(1)
            control.stop.set()
            report = await scan
            assert report.stopped_early
            assert 0 < report.stored < 300
            other = asyncio.ensure_future(hsi.scan(hsi.default_plan(lines=300), "b.zarr"))
            await asyncio.sleep(2)
            other.cancel()
            await asyncio.gather(other, return_exceptions=True)
            await asyncio.sleep(1)
            assert service.station.jobs.all()[0].state == "cancelled"

    run(main())


def test_control_is_taken_once_kept_and_given_up(tmp_path: Path) -> None:
    async def main() -> None:
        async with remote(tmp_path) as (hsi, service):
            assert service.station.lease.holder is None
            await hsi.actuator.home()
            await asyncio.sleep(300)
            holder = service.station.lease.holder
            assert holder is not None
            assert holder.name == "Ada"
            transport = httpx.ASGITransport(app=service.app)
            async with connect_instrument("http://localhost", name="Bob", transport=transport) as other:
                assert (await other.state())["lease"]["name"] == "Ada"
                with pytest.raises(DeviceBusy, match="Ada is in control"):
                    await other.actuator.home()
                await other.stop()
        assert service.station.lease.holder is None

    run(main())


def test_a_calibration_from_afar(tmp_path: Path) -> None:
    async def main() -> None:
        async with remote(tmp_path / "data") as (hsi, _):
            dark = await hsi.calibrate.run("dark", tmp_path / "dark.nc", frames=2)
            assert isinstance(dark, DarkModel)
            assert dark.provenance.simulated

    run(main())
    assert (tmp_path / "dark.nc").is_file()


def test_nobody_there() -> None:
    async def main() -> None:
        with pytest.raises(DeviceNotFound, match="nothing answers"):
            async with connect_instrument("http://127.0.0.1:9"):
                pass

    asyncio.run(main())


@pytest.mark.parametrize(
    "error",
    [
        errors.OutOfRange("9 s is not allowed.", device="camera", operation="configure", hint="less"),
        errors.DeviceTimeout("no answer.", device="mirror", waited_s=3.0, line=7),
        errors.ConfigError("the plan is wrong:", ["one", "two"]),
        ScanFailed([errors.DeviceLost("gone.", device="camera")], stored=3, lines=9),
        errors.CubeExists("there already."),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_come_through_as_they_are(error: errors.ScanhsiError) -> None:
    again = error_of(problem_of(error))
    assert type(again) is type(error)
    assert str(again).split("\n")[0] == str(error).split("\n")[0]
    for name in ("device", "operation", "line", "waited_s", "hint", "stored", "lines", "problems"):
        assert getattr(again, name, None) == getattr(error, name, None)


def test_every_field_of_a_plan_can_be_sent() -> None:
    assert set(PlanBody.model_fields) == set(ScanPlan.model_fields)

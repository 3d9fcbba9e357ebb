"""A service outlives the loss of its devices: nobody has to restart it, and nothing moves by itself when one is back."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import httpx
import pytest

from scanhsi.client import connect_instrument
from scanhsi.clock import now_ns
from scanhsi.devices.errors import ScanFailed
from scanhsi.testing.faults import FaultPlan, Faults
from scanhsi.testing.instrument import with_faults
from scanhsi.testing.witness import Witness
from support.service import Service, small, with_service

AWAY_S = 30.0
UNPLUGGED = {"camera": ("camera unplugged", 8), "actuator": ("actuator unplugged", 6)}


def with_loss(
    folder: Path,
    device: str,
    use: Callable[[Service], Coroutine[Any, Any, None]],
    witness: Witness | None = None,
    away_s: float = AWAY_S,
) -> None:
    """Use a service that loses a device in its first scan, and could have it back so much later."""
    kind, nth = UNPLUGGED[device]
    plan = FaultPlan.model_validate({"faults": [{"kind": kind, "nth": nth, "for_s": away_s}]})
    with_service(folder, use, with_faults(small(), Faults(plan, now_ns), witness))


async def state(service: Service) -> dict[str, Any]:
    return (await service.http.get("/state")).json()


async def scan(service: Service, **more: Any) -> dict[str, Any]:
    answer = await service.http.post("/scans", json={"plan": {"lines": 10}, "discard": True, **more})
    return await service.done(answer.json()["id"])


async def lose(service: Service, device: str) -> None:
    if "Scanhsi-Lease" not in service.http.headers:
        await service.take_control()
    assert (await state(service))["lost"] == {}
    job = await scan(service)
    assert (job["state"], job["problem"]["error"]) == ("failed", "ScanFailed")
    assert job["problem"]["lost"].keys() == {device}
    assert (await state(service))["lost"] == job["problem"]["lost"]


def refusal(answer: httpx.Response) -> tuple[int, str, str]:
    problem = answer.json()
    return answer.status_code, problem["error"], problem["hint"]


@pytest.mark.parametrize("device", ["camera", "actuator"])
def test_the_next_scan_has_it_back(device: str, tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        await lose(service, device)
        job = await scan(service, discard=False, output="too-early")
        assert (job["state"], job["problem"]["error"], job["problem"]["hint"]) == (
            "failed",
            "DeviceNotFound",
            "plug it in.",
        )
        assert not list(tmp_path.glob("*.zarr"))
        assert "connect: nothing answers" in (await state(service))["lost"][device]
        await asyncio.sleep(AWAY_S)
        job = await scan(service)
        assert (job["state"], job["result"]["missing"]) == ("done", 0)
        assert (await state(service))["lost"] == {}

    with_loss(tmp_path, device, use)


def test_a_mirror_that_was_lost_is_homed_before_it_is_moved(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await lose(service, "actuator")
        mirror = (await http.get("/mirror")).json()
        assert (mirror["step"], mirror["homed"]) == (None, False)
        for path, body in (("home", None), ("goto", {"step": 5}), ("jog", {"steps": 5})):
            assert refusal(await http.post(f"/mirror/{path}", json=body)) == (503, "DeviceNotFound", "plug it in.")
        assert (await http.post("/stop")).status_code == 503, "nobody knows whether it stands"
        await asyncio.sleep(AWAY_S)
        assert refusal(await http.post("/mirror/jog", json={"steps": 5})) == (409, "PositionLost", "home it")
        assert (await state(service))["lost"] == {}
        assert refusal(await http.post("/mirror/goto", json={"step": 5})) == (409, "PositionLost", "home it")
        assert (await http.post("/mirror/home")).json()["homed"]
        assert (await http.post("/mirror/goto", json={"step": 5})).json()["step"] == 5

    with_loss(tmp_path, "actuator", use)


def test_without_its_camera_the_mirror_moves_and_settings_are_taken(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        await lose(service, "camera")
        assert (await service.http.post("/mirror/jog", json={"steps": 3})).status_code == 200
        assert (await service.http.patch("/camera", json={"exposure_s": 0.03})).json()["exposure_s"] == 0.03
        assert (await state(service))["lost"].keys() == {"camera"}
        live = await service.http.put("/live", json={"on": True})
        assert refusal(live) == (503, "DeviceNotFound", "plug it in.")
        assert not (await state(service))["live"]
        await asyncio.sleep(AWAY_S)
        assert (await service.http.put("/scene", json={"scene": "white"})).json()["lost"] == {}

    with_loss(tmp_path, "camera", use)


def test_a_mirror_that_was_unsafe_does_not_move_by_itself(tmp_path: Path) -> None:
    """Neither as it is opened anew nor because a live view was on, which would home it."""
    witness = Witness()

    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        await http.put("/live", json={"on": True})
        await asyncio.sleep(1.5)
        await lose(service, "actuator")
        witness.moved = False
        await asyncio.sleep(3)
        assert (await http.patch("/camera", json={"exposure_s": 0.03})).status_code == 200
        assert (await http.post("/devices/reopen", json={})).json()["lost"] == {}
        await asyncio.sleep(3)
        assert not witness.moved
        assert not (await state(service))["live"]
        await http.put("/live", json={"on": True})
        await asyncio.sleep(3)
        assert witness.moved
        assert (await http.get("/mirror")).json()["homed"]

    with_loss(tmp_path, "actuator", use, witness, away_s=0)


def test_opening_anew_by_hand(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        assert (await http.post("/devices/reopen", json={})).json()["error"] == "NotInControl"
        await lose(service, "camera")
        assert refusal(await http.post("/devices/reopen", json={})) == (503, "DeviceNotFound", "plug it in.")
        await asyncio.sleep(AWAY_S)
        async with service.socket("/events") as events:
            assert (await http.post("/devices/reopen", json={})).json()["lost"] == {}
            told = [await events.json() for _ in range(2)]
            assert told[0]["data"]["lost"].keys() == {"camera"}
            assert told[-1]["data"]["lost"] == {}
        await http.post("/mirror/home")
        whole = await http.post("/devices/reopen", json={"devices": ["actuator", "camera"]})
        assert (whole.status_code, whole.json()["mirror"]["homed"]) == (200, False)
        dark = await http.post("/devices/reopen", json={"devices": ["light"]})
        assert (dark.status_code, dark.json()["error"]) == (422, "UnsupportedFeature")
        assert (await http.post("/devices/reopen", json={"devices": ["lens"]})).status_code == 422
        scanning = asyncio.ensure_future(scan(service))
        await asyncio.sleep(0.1)
        busy = await http.post("/devices/reopen", json={"devices": ["camera"]})
        assert (busy.status_code, busy.json()["error"]) == (409, "DeviceBusy")
        assert (await scanning)["state"] == "done"

    with_loss(tmp_path, "camera", use)


def test_from_afar(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        transport = httpx.ASGITransport(app=service.app)
        async with connect_instrument("http://localhost", name="Ada", transport=transport) as hsi:
            plan = hsi.default_plan(lines=10)
            with pytest.raises(ScanFailed) as failed:
                await hsi.scan(plan, None)
            assert failed.value.lost.keys() == {"camera"}
            await asyncio.sleep(AWAY_S)
            await hsi.reopen()
            assert (await hsi.state())["lost"] == {}
            await hsi.reopen("actuator")
            assert (await hsi.scan(plan, None)).missing == 0

    with_loss(tmp_path, "camera", use)

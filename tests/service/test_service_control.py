"""One in control, STOP for everybody, commands that are sent twice, jobs that wait, stop and fail."""

from __future__ import annotations

import asyncio
import inspect
from pathlib import Path

import pytest

import scanhsi
from scanhsi.characterise.calibrator import Calibrator
from scanhsi.cube.verify import verify_cube
from scanhsi.service.calibrations import CALIBRATIONS
from support.service import Service, small, with_service


def test_control_is_taken_kept_and_not_stolen(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        nobody = await http.post("/mirror/home")
        assert (nobody.status_code, nobody.json()["error"]) == (403, "NotInControl")
        await service.take_control("Ada")
        stolen = await http.post("/lease", json={"name": "Bob"})
        assert (stolen.status_code, stolen.json()["error"]) == (409, "LeaseHeld")
        assert "Ada" in stolen.json()["detail"]
        guessed = await http.post("/mirror/home", headers={"Scanhsi-Lease": "guess"})
        assert guessed.status_code == 403
        assert (await http.delete("/lease", headers={"Scanhsi-Lease": "guess"})).status_code == 403
        assert (await http.post("/mirror/home")).status_code == 200
        for _ in range(5):  # signs of life keep it
            await asyncio.sleep(40)
            assert (await http.put("/lease")).status_code == 200
        assert (await http.get("/lease")).json()["holder"]["name"] == "Ada"
        await asyncio.sleep(61)
        assert (await http.get("/lease")).json()["holder"] is None
        assert (await http.post("/mirror/home")).status_code == 403
        del http.headers["Scanhsi-Lease"]
        await service.take_control("Bob")
        assert (await http.delete("/lease")).json()["holder"] is None

    with_service(tmp_path, use)


def test_nobody_learns_the_lease_of_another(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        async with service.socket("/events") as socket:
            hello = await socket.json()
            await service.take_control()
            await service.http.post("/mirror/home")
            id = service.http.headers["Scanhsi-Lease"]
            told = [hello, *[await socket.json() for _ in range(4)]]
            assert {"hello", "lease", "state"} <= {event["type"] for event in told}
            everything = [str(told), (await service.http.get("/state")).text, (await service.http.get("/lease")).text]
            assert not any(id in text for text in everything)

    with_service(tmp_path, use)


def test_stop_is_for_everybody_and_ends_a_scan(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        await service.take_control()
        job = (await service.http.post("/scans", json={"plan": {"lines": 400}, "output": "a"})).json()
        waiting = asyncio.ensure_future(service.http.post("/mirror/home"))
        await asyncio.sleep(3)
        assert (await waiting).status_code == 409  # the scan has the devices
        assert (await service.http.post("/stop", headers={"Scanhsi-Lease": ""})).status_code == 200
        ended = (await service.http.get(f"/jobs/{job['id']}")).json()
        assert ended["state"] == "cancelled"
        assert (await service.http.get("/state")).json()["busy"] == "idle"

    with_service(tmp_path, use)
    verified = verify_cube(tmp_path / "a.zarr")
    assert verified.intact
    assert 0 < verified.lines_stored < 400


def test_stop_ends_a_motion_and_what_waits_behind_it(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        await http.post("/mirror/home")
        far = int(service.station.imager.instrument.actuator_info.limits.maximum)
        far = min(far, 4000)
        moving = asyncio.ensure_future(http.post("/mirror/goto", json={"step": far}))
        behind = asyncio.ensure_future(http.post("/mirror/goto", json={"step": 0}))
        await asyncio.sleep(0.2)
        assert (await http.get("/state")).json()["busy"] == "moving"
        stopped = (await http.post("/mirror/stop")).json()
        assert (await moving).json()["error"] == "DeviceBusy"
        assert (await behind).status_code == 409
        assert 0 < stopped["step"] < far
        await asyncio.sleep(5)
        assert (await http.get("/mirror")).json()["step"] == stopped["step"]

    with_service(tmp_path, use)


def test_a_command_sent_twice_is_done_once(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        await http.post("/mirror/home")
        key = {"Idempotency-Key": "a1"}
        first, again = await asyncio.gather(
            *(http.post("/mirror/jog", json={"steps": 10}, headers=key) for _ in range(2))
        )
        assert first.json()["step"] == again.json()["step"] == 10
        assert again.headers["idempotency-replayed"] == "true"
        assert (await http.get("/mirror")).json()["step"] == 10
        other = await http.post("/mirror/jog", json={"steps": 11}, headers=key)
        assert (other.status_code, other.json()["error"]) == (422, "KeyReused")
        failed = {"Idempotency-Key": "b"}
        assert (await http.post("/mirror/goto", json={"step": 10**8}, headers=failed)).status_code == 422
        assert (await http.post("/mirror/goto", json={"step": 4}, headers=failed)).json()["step"] == 4
        secret = await http.post("/lease", json={"name": "x"}, headers=key)
        assert secret.status_code == 409

    with_service(tmp_path, use)


def test_a_scan_is_finished_early_and_one_at_a_time(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        job = (await http.post("/scans", json={"plan": {"lines": 400}, "output": "a"})).json()
        second = await http.post("/scans", json={"plan": {"lines": 4}, "output": "b"})
        assert (second.status_code, second.json()["error"]) == (409, "DeviceBusy")
        await asyncio.sleep(3)
        await http.post(f"/jobs/{job['id']}/finish")
        ended = await service.done(job["id"])
        assert ended["state"] == "stopped"
        stored = ended["result"]["stored"]
        assert 0 < stored < 400
        rest = (await http.post("/cubes/a.zarr/resume")).json()
        whole = await service.done(rest["id"])
        assert (whole["state"], whole["result"]["resumed_at"]) == ("done", stored), whole["problem"]
        assert (await http.get("/cubes/a.zarr")).json()["lines_stored"] == 400
        assert (await http.post(f"/jobs/{job['id']}/cancel")).status_code == 409
        assert (await http.get("/jobs/abc")).status_code == 404

    with_service(tmp_path, use)
    assert scanhsi.open_cube(tmp_path / "a.zarr").attrs["lines_stored"] > 0


def test_a_scan_is_paused_and_goes_on(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        job = (await http.post("/scans", json={"plan": {"lines": 100}, "output": "a"})).json()
        assert job["can_pause"] is True
        await asyncio.sleep(2)
        assert (await http.post(f"/jobs/{job['id']}/pause")).json()["state"] == "paused"
        await asyncio.sleep(1)
        taken = (await http.get(f"/jobs/{job['id']}")).json()["progress"]["taken"]
        await asyncio.sleep(50)
        held = (await http.get(f"/jobs/{job['id']}")).json()
        assert (held["state"], held["progress"]["taken"] - taken <= 20) == ("paused", True)
        assert (await http.post(f"/jobs/{job['id']}/resume")).json()["state"] == "running"
        ended = await service.done(job["id"])
        assert (ended["state"], ended["result"]["stored"]) == ("done", 100)

    with_service(tmp_path, use)


def test_a_failed_scan_tells_why(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()

    async def use(service: Service) -> None:
        await service.take_control()
        (tmp_path / "data" / "a.zarr").symlink_to(tmp_path / "nowhere")
        answer = await service.http.post("/scans", json={"plan": {"lines": 4}, "output": "a"})
        assert (answer.status_code, answer.json()["error"]) == (409, "CubeExists")
        wrong = await service.http.post("/scans", json={"plan": {"lines": 4, "mode": "stepped", "period_s": 1.0}})
        assert (wrong.status_code, wrong.json()["error"]) == (422, "ConfigError")
        assert wrong.json()["problems"]

    with_service(tmp_path / "data", use)


def test_a_calibration_waits_for_a_person(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def use(service: Service) -> None:
        http = service.http
        camera = service.station.imager.camera
        monkeypatch.setattr(type(camera), "scenes", property(lambda self: ()))  # as a real one: nothing to show
        await service.take_control()
        asked = (await http.post("/calibrations", json={"kind": "dark", "output": "d.nc", "frames": 2})).json()
        assert (await http.post(f"/jobs/{asked['id']}/pause")).status_code == 409
        await asyncio.sleep(1)
        job = (await http.get(f"/jobs/{asked['id']}")).json()
        assert (job["state"], "shutter" in job["prompt"]) == ("waiting", True)
        assert (await http.post(f"/jobs/{asked['id']}/confirm")).status_code == 200
        await asyncio.sleep(0.5)
        job = (await http.get(f"/jobs/{asked['id']}")).json()
        assert (job["state"], job["prompt"]) == ("running", None)
        assert (await http.post(f"/jobs/{asked['id']}/cancel")).status_code == 200
        assert (await service.done(asked["id"]))["state"] == "cancelled"
        assert not (tmp_path / "d.nc").exists()
        assert (await http.post(f"/jobs/{asked['id']}/confirm")).status_code == 409

    with_service(tmp_path, use, small(**{"camera.scene": "dark"}))


def test_options_of_calibrations_are_checked(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        unknown = await http.post("/calibrations", json={"kind": "dark", "tile": 0.5})
        assert (unknown.status_code, unknown.json()["problems"]) == (422, ["tile: dark has no such option"])
        absent = await http.post("/calibrations", json={"kind": "white", "dark": "none.nc"})
        assert (absent.status_code, absent.json()["error"]) == (404, "NoSuch")
        assert (await http.get("/jobs")).json() == []

    with_service(tmp_path, use)


def test_every_protocol_can_be_asked_for() -> None:
    protocols = {
        name
        for name, protocol in inspect.getmembers(Calibrator, inspect.iscoroutinefunction)
        if "output" in inspect.signature(protocol).parameters and not name.startswith("_")
    }
    assert protocols - set(CALIBRATIONS) == {"wavelength_tile"}  # which needs a certificate


def test_the_live_view_gives_way_and_comes_back(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        async with service.socket("/preview") as socket:
            await http.put("/live", json={"on": True})
            header, pixels = await socket.binary()
            assert (header["kind"], header["of"], header["shape"]) == ("frame", "live", [16, 24])
            assert len(pixels) == 16 * 24
            assert sum(header["histogram"]) == 16 * 24
            await http.post("/mirror/jog", json={"steps": 8})
            while (await socket.binary())[0]["of"] != "live":
                pass
            job = await service.scan("a", 40)
            rows = [header for header, _ in [await socket.binary() for _ in range(12)] if header["kind"] == "rows"]
            assert {row["of"] for row in rows} == {job["id"]}
            assert [row["first"] for row in rows] == sorted(row["first"] for row in rows)
            while (await socket.binary())[0]["of"] != "live":
                pass
            await http.put("/live", json={"on": False})
            assert (await http.get("/state")).json()["busy"] == "idle"

    with_service(tmp_path, use)

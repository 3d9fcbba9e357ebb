"""A whole session over REST, in virtual time: align, expose, calibrate, plan, scan, view, download."""

from __future__ import annotations

import asyncio
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zarr

import scanhsi
from support.service import Service, small, with_service

COLOUR = {"roi.samples": 40, "roi.bands": 200, "roi.sample_offset": 1000, "roi.band_offset": 300}


def test_motion_and_settings(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        state = (await http.get("/state")).json()
        assert (state["simulated"], state["busy"], state["mirror"]["homed"]) == (True, "idle", False)
        await service.take_control()
        lost = await http.post("/mirror/goto", json={"step": 5})
        assert (lost.status_code, lost.json()["error"], lost.json()["hint"]) == (409, "PositionLost", "home it")
        assert (await http.post("/mirror/home")).json()["homed"] is True
        assert (await http.post("/mirror/goto", json={"step": 120})).json()["step"] == 120
        both = await asyncio.gather(*(http.post("/mirror/jog", json={"steps": -10}) for _ in range(2)))
        assert sorted(answer.json()["step"] for answer in both) == [100, 110]
        far = await http.post("/mirror/goto", json={"step": 10**6})
        assert (far.status_code, far.json()["error"]) == (422, "OutOfRange")
        assert "allowed" in far.json()["detail"]
        assert (await http.patch("/camera", json={"exposure_s": 0.05})).json()["exposure_s"] == 0.05
        refused = await http.patch("/camera", json={"exposure_s": 50})
        assert (refused.status_code, refused.json()["error"]) == (422, "OutOfRange")
        assert (await http.get("/camera")).json()["exposure_s"] == 0.05

    with_service(tmp_path, use)


def test_a_scan_is_a_job_and_gives_the_cube_of_a_script(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        await service.take_control()
        job = await service.scan("hand", 30)
        assert (job["state"], job["output"], job["result"]["stored"]) == ("done", "hand.zarr", 30)
        assert job["result"]["simulated"] is True
        assert job["progress"]["taken"] == 30
        assert sum(share["alone_s"] for share in job["progress"]["budget"].values()) == pytest.approx(
            job["progress"]["period_s"], rel=1e-6
        )
        again = await service.http.post("/scans", json={"plan": {"lines": 3}, "output": "hand.zarr"})
        assert (again.status_code, again.json()["error"]) == (409, "CubeExists")
        (entry,) = (await service.http.get("/cubes")).json()
        assert (entry["id"], entry["lines_stored"], entry["simulated"]) == ("hand.zarr", 30, True)

    with_service(tmp_path / "data", use)
    from scanhsi.clock import run_virtual

    async def script() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            await hsi.scan(hsi.default_plan(lines=30), tmp_path / "script.zarr")

    run_virtual(script())
    theirs, ours = (
        scanhsi.open_cube(path, chunks=None) for path in (tmp_path / "script.zarr", tmp_path / "data" / "hand.zarr")
    )
    assert (theirs["cube"].values == ours["cube"].values).all()
    assert (theirs["mirror_step"].values == ours["mirror_step"].values).all()


def test_pictures_spectra_and_downloads(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        await service.scan("a", 12)
        info = (await http.get("/cubes/a.zarr")).json()
        assert len(info["wavelength_nm"]) == 200
        assert info["attributes"]["plan"]["lines"] == 12
        assert (await http.get("/cubes/a.zarr/colour")).content.startswith(b"\x89PNG")
        band = await http.get("/cubes/a.zarr/band", params={"wavelength_nm": info["wavelength_nm"][7] + 0.1})
        assert band.headers["scanhsi-band"] == "7"
        cube = scanhsi.open_cube(tmp_path / "a.zarr", chunks=None)["cube"].values
        point = (await http.get("/cubes/a.zarr/spectrum", params={"line": 3, "sample": 4})).json()
        assert point["mean"] == cube[:, 3, 4].tolist()
        region = {"line": 2, "line_end": 9, "sample": 1, "sample_end": 5}
        mean = (await http.get("/cubes/a.zarr/spectrum", params=region)).json()
        assert mean["pixels"] == 28
        assert mean["mean"] == pytest.approx(cube[:, 2:9, 1:5].mean(axis=(1, 2)).tolist())
        some = (await http.get("/cubes/a.zarr/random-spectra", params={"count": 5})).json()
        assert [cube[:, a, b].tolist() for a, b in zip(some["lines"], some["samples"], strict=True)] == some["spectra"]
        outside = await http.get("/cubes/a.zarr/spectrum", params={"line": 99, "sample": 4})
        assert outside.status_code == 422

        zipped = (await http.get("/cubes/a.zarr/download")).content
        with zipfile.ZipFile(io.BytesIO(zipped)) as archive:
            assert archive.testzip() is None
            archive.extractall(tmp_path / "out")
        group = zarr.open_group(tmp_path / "out", mode="r")
        assert (np.asarray(group["cube"][:, :12]) == cube).all()
        prepared = await http.post("/cubes/a.zarr/downloads", json={"format": "envi"})
        url = prepared.json()["url"].removeprefix("/api/v1")
        envi = await http.get(url)
        assert sorted(zipfile.ZipFile(io.BytesIO(envi.content)).namelist()) == ["a.bil", "a.hdr"]
        assert (await http.get(url)).status_code == 404  # once only
        for format in ("netcdf", "matlab"):
            assert len((await http.get("/cubes/a.zarr/download", params={"format": format})).content) > cube.nbytes / 4
        assert not list(tmp_path.glob(".download-*"))

    with_service(tmp_path, use, small(**COLOUR, **{"camera.scene": "hand"}))


def test_references_recipes_plans_and_sheet(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        await service.take_control()
        found = await service.done((await http.post("/auto-exposure", json={})).json()["id"])
        assert found["state"] in ("done", "failed"), found
        job = (await http.post("/calibrations", json={"kind": "dark", "output": "dark", "frames": 4})).json()
        dark = await service.done(job["id"])
        assert (dark["state"], dark["output"]) == ("done", "dark.nc"), dark["problem"]
        (entry,) = (await http.get("/calibrations")).json()
        assert (entry["kind"], entry["simulated"], entry["applies"]) == ("dark", True, True)
        assert (await http.get("/spec")).json()["simulated"] is True

        plan = {"lines": 50, "exposure_s": 0.03, "step": 1}
        facts = (await http.post("/plan", json=plan)).json()
        assert facts["time"]["scan_s"] > 50 * 0.03
        assert facts["size_bytes"] == 50 * 16 * 24 * 2
        assert facts["field"]["aspect"] == pytest.approx(facts["field"]["line_pitch_mm"] / 0.155)
        field = (await http.post("/plan/field", json={"height_mm": 20})).json()
        assert field["height_mm"] == pytest.approx(20, abs=1)
        assert (await http.put("/recipes/slow", json={"plan": plan, "target": "leaf"})).status_code == 200
        assert [recipe["name"] for recipe in (await http.get("/recipes")).json()] == ["slow"]
        scan = {"recipe": "slow", "plan": {"lines": 5}, "output": "leaf"}
        begun = await http.post("/scans", json=scan)
        assert begun.status_code == 201, begun.text
        done = await service.done(begun.json()["id"])
        assert (done["result"]["lines"], done["result"]["exposure_s"]) == (5, 0.03)
        assert (await http.get("/cubes/leaf.zarr")).json()["target"] == "leaf"
        assert (await http.delete("/recipes/slow")).status_code == 204
        assert (await http.get("/recipes/slow")).status_code == 404

    with_service(tmp_path, use, small(**{"camera.scene": "white"}))


def test_a_benchmark(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        await service.take_control()
        asked = {"exposures_s": [0.1], "modes": ["sequential", "stepped"], "lines": 20}
        job = await service.done((await service.http.post("/benchmarks", json=asked)).json()["id"])
        sequential, stepped = job["result"]["rows"]
        assert sequential["efficiency"] < stepped["efficiency"] <= 1

    with_service(tmp_path, use)

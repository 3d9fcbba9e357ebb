"""Scans, calibrations, auto-exposure: jobs, and what can be done with one."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query
from pydantic import Field

from scanhsi.service.calibrations import CalibrationBody, options_of
from scanhsi.service.models import BenchmarkBody, Body, JobModel, ScanBody
from scanhsi.service.recipes import read_recipe
from scanhsi.service.routes.common import IN_CONTROL, CubeId, StationHere, problems
from scanhsi.service.work import (
    auto_exposure_job,
    benchmark_job,
    calibration_job,
    continued_job,
    plan_for,
    scan_job,
)

router = APIRouter()
JobId = Annotated[str, Path(pattern=r"^[0-9a-f]{1,32}$", description="Id of the job.", examples=["3f9c1a2b4d5e"])]


class AutoExposureBody(Body):
    """How bright the white tile is to be."""

    target: float = Field(default=0.85, ge=0.05, le=0.98, description="Of the brightest pixels, share of full scale.")


@router.post(
    "/scans", tags=["jobs"], status_code=201, dependencies=[IN_CONTROL], responses=problems(404, 409, 503, 504)
)
async def start_scan(station: StationHere, body: ScanBody) -> JobModel:
    """Scan. Answers at once; the job tells how far it is."""
    recipe = None if body.recipe is None else read_recipe(station.folder, body.recipe)
    begun = {} if recipe is None else recipe.plan.given()
    target = body.target if body.target is not None or recipe is None else recipe.target
    plan = plan_for(station, begun | body.plan.given())
    job = scan_job(station, plan, body.output, discard=body.discard, target=target, real_time=body.real_time)
    return JobModel.of(job)


@router.post(
    "/cubes/{id}/resume", tags=["jobs"], status_code=201, dependencies=[IN_CONTROL], responses=problems(404, 409)
)
async def resume_scan(station: StationHere, id: CubeId) -> JobModel:
    """Finish a scan that was interrupted: killed, failed, or ended early. Only lines that are not stored are taken."""
    return JobModel.of(continued_job(station, id))


@router.post("/calibrations", tags=["jobs"], status_code=201, dependencies=[IN_CONTROL], responses=problems(404, 409))
async def start_calibration(station: StationHere, body: CalibrationBody) -> JobModel:
    """Calibrate. Where a person has to put something before the instrument, the job waits until that is confirmed."""
    options = await station.background.run(options_of, body, station.folder)
    asked = body.model_dump(mode="json", exclude_none=True)
    return JobModel.of(calibration_job(station, body.kind, body.output, options, asked))


@router.post("/benchmarks", tags=["jobs"], status_code=201, dependencies=[IN_CONTROL], responses=problems(409))
async def start_benchmark(station: StationHere, body: BenchmarkBody) -> JobModel:
    """Measure line periods and efficiency: short scans that store nothing, in every mode, format and exposure asked for."""
    return JobModel.of(
        benchmark_job(
            station, exposures_s=body.exposures_s, modes=body.modes, formats=body.pixel_formats, lines=body.lines
        )
    )


@router.post("/auto-exposure", tags=["jobs"], status_code=201, dependencies=[IN_CONTROL], responses=problems(409))
async def start_auto_exposure(station: StationHere, body: AutoExposureBody) -> JobModel:
    """Find the exposure of what is before the instrument, a white tile, and set it."""
    return JobModel.of(auto_exposure_job(station, body.target))


@router.get("/jobs", tags=["jobs"], responses=problems())
async def list_jobs(station: StationHere) -> list[JobModel]:
    """The last jobs, the youngest first."""
    return [JobModel.of(job) for job in station.jobs.all()]


@router.get("/jobs/{id}", tags=["jobs"], responses=problems(404))
async def get_job(
    station: StationHere,
    id: JobId,
    wait_s: Annotated[
        float, Query(ge=0, le=30, description="Answer when it is over or waits for a person, or after so long.")
    ] = 0.0,
) -> JobModel:
    """One job."""
    job = station.jobs.get(id)
    await job.settled(wait_s)
    return JobModel.of(job)


@router.post("/jobs/{id}/pause", tags=["jobs"], dependencies=[IN_CONTROL], responses=problems(404, 409))
async def pause_job(station: StationHere, id: JobId) -> JobModel:
    """Hold a scan after the line under way."""
    return JobModel.of(station.jobs.pause(id))


@router.post("/jobs/{id}/resume", tags=["jobs"], dependencies=[IN_CONTROL], responses=problems(404, 409))
async def resume_job(station: StationHere, id: JobId) -> JobModel:
    """Go on with a scan that was paused."""
    return JobModel.of(station.jobs.resume(id))


@router.post("/jobs/{id}/finish", tags=["jobs"], dependencies=[IN_CONTROL], responses=problems(404, 409))
async def finish_job(station: StationHere, id: JobId) -> JobModel:
    """End a scan after the line under way; its cube is valid and shorter."""
    return JobModel.of(station.jobs.finish(id))


@router.post("/jobs/{id}/cancel", tags=["jobs"], dependencies=[IN_CONTROL], responses=problems(404, 409))
async def cancel_job(station: StationHere, id: JobId) -> JobModel:
    """End a job at once; what was stored is safe."""
    return JobModel.of(station.jobs.cancel(id))


@router.post("/jobs/{id}/confirm", tags=["jobs"], dependencies=[IN_CONTROL], responses=problems(404, 409))
async def confirm_job(station: StationHere, id: JobId) -> JobModel:
    """What the job waited for is done: the tile is in place, the lamp is on."""
    return JobModel.of(station.jobs.confirm(id))

"""Results of calibrations, and the specification sheet."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse

from scanhsi.calibration.conditions import Conditions
from scanhsi.service import results
from scanhsi.service.folder import NAME
from scanhsi.service.models import ResultEntry, SheetModel
from scanhsi.service.routes.common import StationHere, problems

router = APIRouter(tags=["results"])
_FILE = {
    200: {
        "content": {"application/x-netcdf": {"schema": {"type": "string", "format": "binary"}}},
        "description": "NetCDF-4.",
    }
}
ResultId = Annotated[str, Path(pattern=NAME, description="Name of the result.", examples=["dark.nc"])]


@router.get("/calibrations", responses=problems())
async def list_calibrations(station: StationHere) -> list[ResultEntry]:
    """Results in the data folder with what they say and how old they are, the youngest first."""
    settings, roi = station.settings, station.imager.config.roi
    now = Conditions(
        gain_db=settings.gain_db,
        pixel_format=str(settings.pixel_format),
        roi=None if roi is None else roi.model_dump(),
    )
    return await station.background.run(lambda: results.entries(station.folder.results(), now))


@router.get("/calibrations/{id}/file", response_class=FileResponse, responses=problems(404) | _FILE)
async def get_calibration_file(station: StationHere, id: ResultId) -> FileResponse:
    """The result as a file (NetCDF-4)."""
    path = station.folder.result(id)
    return FileResponse(path, media_type="application/x-netcdf", filename=path.name)


@router.get("/spec", responses=problems())
async def get_spec(station: StationHere) -> SheetModel:
    """The specification sheet: every row from a stored result, "not measured" where there is none."""
    sheet = await station.background.run(lambda: results.sheet(station.folder.results(), station.imager.config))
    return SheetModel(**sheet)

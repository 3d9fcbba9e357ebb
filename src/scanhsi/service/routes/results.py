"""Results of calibrations, and the specification sheet."""

from __future__ import annotations

from fastapi import APIRouter

from scanhsi.calibration.conditions import Conditions
from scanhsi.service import results
from scanhsi.service.models import ResultEntry, SheetModel
from scanhsi.service.routes.common import StationHere, problems

router = APIRouter(tags=["results"])


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


@router.get("/spec", responses=problems())
async def get_spec(station: StationHere) -> SheetModel:
    """The specification sheet: every row from a stored result, "not measured" where there is none."""
    sheet = await station.background.run(lambda: results.sheet(station.folder.results(), station.imager.config))
    return SheetModel(**sheet)

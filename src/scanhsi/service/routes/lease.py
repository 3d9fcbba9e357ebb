"""Control: one holder at a time."""

from __future__ import annotations

from fastapi import APIRouter

from scanhsi.service.models import HolderModel, LeaseModel, LeaseState, TakeLease
from scanhsi.service.routes.common import LeaseId, StationHere, problems
from scanhsi.service.station import Station

router = APIRouter(prefix="/lease", tags=["control"])


@router.get("", responses=problems())
async def get_lease(station: StationHere) -> LeaseState:
    """Who is in control."""
    return _state(station)


@router.post("", status_code=201, responses=problems(409))
async def take_lease(station: StationHere, body: TakeLease) -> LeaseModel:
    """Take control, if nobody has it. Every command renews it; without any for `ttl_s` it runs out."""
    id = station.lease.take(body.name, body.ttl_s)
    return LeaseModel(id=id, holder=HolderModel(name=body.name, remaining_s=body.ttl_s))


@router.put("", responses=problems())
async def renew_lease(station: StationHere, lease: LeaseId = None) -> LeaseState:
    """A sign of life."""
    station.lease.renew(lease)
    return _state(station)


@router.delete("", responses=problems())
async def release_lease(station: StationHere, lease: LeaseId = None) -> LeaseState:
    """Give control up. What is under way goes on."""
    station.lease.release(lease)
    return _state(station)


def _state(station: Station) -> LeaseState:
    holder = station.lease.holder
    return LeaseState(holder=None if holder is None else HolderModel(name=holder.name, remaining_s=holder.remaining_s))

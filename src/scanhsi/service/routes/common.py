"""What all routes use."""

from __future__ import annotations

from typing import Annotated, Any, Final, cast

from fastapi import Depends, Header, Path
from starlette.requests import HTTPConnection

from scanhsi.service.folder import NAME
from scanhsi.service.models import Problem
from scanhsi.service.problems import MEDIA_TYPE
from scanhsi.service.station import Station

_WHY: Final = {
    401: "The token is missing or wrong.",
    403: "Not in control, or sent by a page of another site.",
    404: "There is nothing of that name.",
    409: "It does not fit what is going on: something else is under way, or the name is taken.",
    413: "The body is too long.",
    422: "A value is not allowed, or the body is not as described.",
    429: "Too many requests.",
    503: "A device is gone or fails.",
    504: "A device did not answer in time.",
}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Error answers of a route, for the OpenAPI description."""
    schema = {"$ref": f"#/components/schemas/{Problem.__name__}"}
    return {
        status: {"description": _WHY[status], "content": {MEDIA_TYPE: {"schema": schema}}}
        for status in sorted({401, 403, 413, 422, 429, *statuses})
    }


def station_of(connection: HTTPConnection) -> Station:
    """The station of the application."""
    return cast("Station", connection.app.state.station)


async def _station(connection: HTTPConnection) -> Station:
    return station_of(connection)  # asynchronous: what is not runs in a thread, without the loop's clock


StationHere = Annotated[Station, Depends(_station)]
LeaseId = Annotated[str | None, Header(alias="Scanhsi-Lease", max_length=200, description="Id of the control lease.")]


async def _in_control(
    station: StationHere,
    lease: LeaseId = None,
    key: Annotated[
        str | None,
        Header(
            alias="Idempotency-Key",
            max_length=200,
            description="Names this command: sent again with the same key it is answered as before, and not done again.",
        ),
    ] = None,
) -> None:
    del key  # `scanhsi.service.idempotency` looks at it
    station.lease.renew(lease)


IN_CONTROL: Final = Depends(_in_control)
"""A command: only for the holder of the control lease, and a sign of life of theirs."""

CubeId = Annotated[str, Path(pattern=NAME, description="Name of the cube.", examples=["hand.zarr"])]

"""The log, and what errors mean."""

from __future__ import annotations

import inspect
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query

from scanhsi.devices import errors
from scanhsi.service import refusals
from scanhsi.service.models import ProblemKind
from scanhsi.service.refusals import NoSuch
from scanhsi.service.routes.common import StationHere, problems

router = APIRouter(tags=["system"])
_OTHERS = {
    "InternalError": "A bug of scanhsi; the log of the service says more.",
    "InvalidRequest": "The request is not as the OpenAPI description has it.",
    "NotFound": "There is no such address.",
    "HttpError": "The request is not one of HTTP that is understood here.",
}


@router.get("/logs", responses=problems())
async def get_logs(station: StationHere, last: Annotated[int, Query(ge=1, le=500)] = 100) -> list[dict[str, Any]]:
    """The last events of the log, the oldest first."""
    return list(station.logged)[-last:]


@router.get("/problems/{name}", responses=problems(404))
async def explain_problem(
    name: Annotated[str, Path(pattern=r"^[A-Za-z]{1,40}$", examples=["OutOfRange"])],
) -> ProblemKind:
    """What an error means: the address in `type` of a problem."""
    kind = getattr(errors, name, None) or getattr(refusals, name, None)
    if inspect.isclass(kind) and issubclass(kind, errors.ScanhsiError):
        return ProblemKind(error=name, explanation=inspect.getdoc(kind) or name)
    if name in _OTHERS:
        return ProblemKind(error=name, explanation=_OTHERS[name])
    raise NoSuch(f"there is no error {name}.")

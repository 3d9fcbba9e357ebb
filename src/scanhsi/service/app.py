"""The application: routes, errors as problem details, the guard in front."""

from __future__ import annotations

from importlib.metadata import version
from importlib.resources import files
from typing import Any, Final

from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.routing import APIRoute
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from scanhsi.devices.errors import ScanhsiError
from scanhsi.log import get_logger
from scanhsi.service.idempotency import Idempotency
from scanhsi.service.models import Problem
from scanhsi.service.problems import MEDIA_TYPE, problem_of
from scanhsi.service.routes import cubes, downloads, instrument, jobs, lease, plans, results, sockets, system
from scanhsi.service.security import Guard, Security
from scanhsi.service.station import Station

PREFIX: Final = "/api/v1"
TAGS: Final = [
    {"name": "instrument", "description": "State and capabilities."},
    {"name": "control", "description": "The control lease: many view, one commands."},
    {"name": "camera", "description": "Settings and live view."},
    {"name": "mirror", "description": "Motion, and STOP."},
    {"name": "jobs", "description": "Scans, calibrations and the like: one at a time."},
    {"name": "plans", "description": "Plan aids and recipes."},
    {"name": "results", "description": "Results of calibrations, and the specification sheet."},
    {"name": "system", "description": "The log, and what errors mean."},
    {"name": "cubes", "description": "What was measured."},
]
_log = get_logger(__name__)


def create_app(station: Station, security: Security | None = None) -> ASGIApp:
    """The service as an ASGI application.

    Args:
        station: Open.
        security: What is asked of those who connect.
    """
    security = security or Security()
    app = _api()
    guard = Guard(Idempotency(app), security)
    app.state.station, app.state.security, app.state.guard = station, security, guard
    return guard


class _Api(FastAPI):
    """Described with its problems and its token."""

    def openapi(self) -> dict[str, Any]:
        if self.openapi_schema is None:
            schema = super().openapi()
            components = schema["components"]
            components["schemas"][Problem.__name__] = Problem.model_json_schema(
                ref_template="#/components/schemas/{model}"
            )
            components["securitySchemes"] = {
                "token": {"type": "http", "scheme": "bearer", "description": "Where the service has a token."}
            }
            schema["security"] = [{}, {"token": []}]
        return self.openapi_schema or {}


def _api() -> FastAPI:
    app = _Api(
        title="scanhsi",
        version=version("scanhsi"),
        description="A line-scanning hyperspectral imager: state, motion, scans as jobs, cubes. WebSockets: `/api/v1/events`, "
        "`/api/v1/preview`. Commands need the control lease (`/api/v1/lease`); STOP needs none.",
        openapi_url=f"{PREFIX}/openapi.json",
        docs_url=None,
        redoc_url=None,
        openapi_tags=TAGS,
        generate_unique_id_function=_operation_id,
    )
    api = APIRouter(prefix=PREFIX)
    for group in (instrument, lease, plans, jobs, cubes, downloads, results, system, sockets):
        api.include_router(group.router)
    app.include_router(api)
    app.mount("/", StaticFiles(directory=str(files("scanhsi.service") / "static"), html=True), name="page")
    app.add_exception_handler(ScanhsiError, _told)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(Exception, _bug)
    return app


def description() -> dict[str, Any]:
    """The OpenAPI description."""
    return _api().openapi()


def _operation_id(route: APIRoute) -> str:
    return route.name


def _answer(problem: dict[str, Any]) -> JSONResponse:
    return JSONResponse(problem, status_code=problem["status"], media_type=MEDIA_TYPE)


async def _told(request: Request, error: Exception) -> JSONResponse:
    problem = problem_of(error)
    _log.info("refused", operation=request.url.path, error=str(error), status=problem["status"])
    return _answer(problem)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    del request
    sentences = [f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}" for item in error.errors()]
    return _answer(
        {
            "type": f"{PREFIX}/problems/InvalidRequest",
            "title": "Invalid request",
            "status": 422,
            "detail": f"the request is not as described: {'; '.join(sentences)}"[:2000],
            "error": "InvalidRequest",
            "problems": sentences[:50],
            "hint": f"GET {PREFIX}/openapi.json",
        }
    )


async def _http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    del request
    name = "NotFound" if error.status_code == 404 else "HttpError"
    problem = {
        "type": f"{PREFIX}/problems/{name}",
        "title": str(error.detail),
        "status": error.status_code,
        "detail": str(error.detail),
        "error": name,
    }
    return JSONResponse(problem, error.status_code, headers=error.headers, media_type=MEDIA_TYPE)


async def _bug(request: Request, error: Exception) -> JSONResponse:
    del request
    return _answer(problem_of(error))

"""Downloads of cubes."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Annotated

from fastapi import APIRouter, Path, Query
from fastapi.responses import StreamingResponse

from scanhsi.service.downloads import TICKET_S, Download, DownloadFormat, download
from scanhsi.service.models import DownloadBody, DownloadModel
from scanhsi.service.routes.common import CubeId, StationHere, problems
from scanhsi.service.station import Station

router = APIRouter(tags=["cubes"])
_FILE = {
    200: {
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
        "description": "The file: a ZIP of the Zarr folder, NetCDF-4, a MAT-file, or a ZIP of ENVI's two files.",
    }
}
Ticket = Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="From the answer to the preparation.")]


@router.get("/cubes/{id}/download", response_class=StreamingResponse, responses=problems(404) | _FILE)
async def download_cube(
    station: StationHere, id: CubeId, format: Annotated[DownloadFormat, Query()] = "zarr"
) -> StreamingResponse:
    """A cube as a file. For programs, which send the token in a header; a browser prepares a download."""
    return await _sent(station, id, format)


@router.post("/cubes/{id}/downloads", status_code=201, responses=problems(404))
async def prepare_download(station: StationHere, id: CubeId, body: DownloadBody) -> DownloadModel:
    """An address that a browser can download from, once and soon, without the token."""
    ticket = station.tickets.issue(station.folder.cube(id).name, body.format)
    return DownloadModel(url=f"/api/v1/downloads/{ticket}", expires_s=TICKET_S)


@router.get("/downloads/{ticket}", response_class=StreamingResponse, responses=problems(404) | _FILE)
async def get_download(station: StationHere, ticket: Ticket) -> StreamingResponse:
    """A prepared download."""
    return await _sent(station, *station.tickets.use(ticket))


async def _sent(station: Station, id: str, format: DownloadFormat) -> StreamingResponse:
    file = await station.background.run(download, station.folder.cube(id), format)
    return StreamingResponse(
        _blocks(station, file),
        media_type=file.media_type,
        headers={"Content-Disposition": f'attachment; filename="{file.name}"'},
    )


async def _blocks(station: Station, file: Download) -> AsyncGenerator[bytes]:
    try:
        while (block := await station.background.run(next, file.blocks, None)) is not None:
            if block:
                yield block
    finally:
        file.blocks.close()

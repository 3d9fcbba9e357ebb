"""Cubes: the list, information, pictures, spectra."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from scanhsi.devices.errors import CubeError
from scanhsi.service import cubes
from scanhsi.service.models import CubeEntry, CubeInfo, SpectraModel, SpectrumModel
from scanhsi.service.routes.common import CubeId, StationHere, problems

router = APIRouter(prefix="/cubes", tags=["cubes"])

_PNG = {200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}, "description": "PNG."}}
Index = Annotated[int, Query(ge=0, le=10_000_000)]


@router.get("", responses=problems())
async def list_cubes(station: StationHere) -> list[CubeEntry]:
    """All cubes in the data folder, the youngest first; damaged ones are left out."""

    def entries() -> list[CubeEntry]:
        found: list[CubeEntry] = []
        for path in station.folder.cubes():
            try:
                found.append(cubes.entry(path))
            except CubeError:
                continue
        return found

    return await station.background.run(entries)


@router.get("/{id}", responses=problems(404))
async def get_cube(station: StationHere, id: CubeId) -> CubeInfo:
    """One cube, with what it says of itself."""
    return await station.background.run(cubes.info, station.folder.cube(id))


@router.get("/{id}/colour", response_class=Response, responses=problems(404) | _PNG)
async def get_colour(station: StationHere, id: CubeId) -> Response:
    """The colour picture, a PNG of 1000 pixels at most; transparent where no line is stored."""
    picture = await station.background.run(cubes.colour_png, station.folder.cube(id))
    return Response(picture, media_type="image/png")


@router.get("/{id}/band", response_class=Response, responses=problems(404) | _PNG)
async def get_band(
    station: StationHere,
    id: CubeId,
    wavelength_nm: Annotated[
        float | None, Query(ge=0, le=100_000, description="The nearest band.", examples=[803.0])
    ] = None,
    band: Annotated[int | None, Query(ge=0, le=1_000_000, description="Or a band by its index.")] = None,
) -> Response:
    """One band in grey; the headers Scanhsi-Band, -Wavelength and -Range tell which, and what is black and white."""
    path = station.folder.cube(id)
    picture, told = await station.background.run(lambda: cubes.band_png(path, wavelength_nm=wavelength_nm, band=band))
    return Response(picture, media_type="image/png", headers=told)


@router.get("/{id}/spectrum", responses=problems(404))
async def get_spectrum(
    station: StationHere,
    id: CubeId,
    line: Index,
    sample: Index,
    line_end: Annotated[int | None, Query(ge=1, le=10_000_000, description="End of a region, left out of it.")] = None,
    sample_end: Annotated[
        int | None, Query(ge=1, le=10_000_000, description="End of a region, left out of it.")
    ] = None,
) -> SpectrumModel:
    """The spectrum at a point, or mean and spread over a region."""
    lines, samples = (line, line_end or line + 1), (sample, sample_end or sample + 1)
    return await station.background.run(cubes.spectrum, station.folder.cube(id), lines, samples)


@router.get("/{id}/random-spectra", responses=problems(404))
async def get_random_spectra(
    station: StationHere,
    id: CubeId,
    count: Annotated[int, Query(ge=1, le=1000)] = 100,
    seed: Annotated[int, Query(ge=0, le=2**32)] = 0,
) -> SpectraModel:
    """Spectra of pixels drawn at random."""
    return await station.background.run(cubes.several, station.folder.cube(id), count, seed)

"""From what a user gives for a cube to be written, to its `Destination`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from scanhsi.cube.destination import Destination
from scanhsi.cube.durable import LocalDestination
from scanhsi.cube.location import locate
from scanhsi.devices.errors import CubeError


def destination_of(
    place: str | Path | Destination,
    storage_options: Mapping[str, str] | None = None,
    *,
    spool: str | Path | None = None,
) -> Destination:
    """The destination of a cube.

    Args:
        place: Path or URL (``s3://bucket/cube.zarr``) of the cube; or its destination, which is returned as it is.
        storage_options: For URLs, see `scanhsi.cube.location.locate`.
        spool: For URLs: local folder that files wait in, see `scanhsi.cube.spooled`.

    Raises:
        CubeError: The URL is wrong, or obstore is not installed, or a spool was given for a path.
    """
    if not isinstance(place, str | Path):
        return place
    location = locate(place, storage_options)
    if (path := location.path) is not None:
        if spool is not None:
            raise CubeError(f"{path} is a folder: a spool is for cubes at URLs.")
        return LocalDestination(path)
    if spool is not None:
        from scanhsi.cube.spooled import SpooledDestination

        return SpooledDestination(location, Path(spool))
    from scanhsi.cube.object_destination import ObjectDestination

    return ObjectDestination(location)

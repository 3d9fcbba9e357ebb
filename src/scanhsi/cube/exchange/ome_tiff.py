"""OME-TIFF: chosen bands as channels, for Fiji, QuPath, napari."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from scanhsi.cube.exchange.envi import write_planes
from scanhsi.cube.exchange.output import new_files
from scanhsi.cube.exchange.source import Source


def write_ome_tiff(source: Source, output: Path) -> list[Path]:
    """Write bands as channels (C, Y, X), BigTIFF, not compressed; returns the path.

    Lines that are missing hold the value of saturated pixels (nan for float) and are listed in a map annotation.

    Raises:
        CubeExists, CubeError: As `new_files`.
    """
    with new_files(output) as (new,):
        place: Any = tifffile.imwrite(
            new,
            shape=source.shape,
            dtype=source.dtype.newbyteorder("<"),
            ome=True,
            bigtiff=True,
            byteorder="<",
            photometric="minisblack",
            contiguous=True,
            returnoffset=True,
            metadata=_metadata(source),
        )
        with new.open("r+b") as file:
            write_planes(source, file, place[0])
    source.notes.append("OME-TIFF carries no records of the lines: no mirror angles, no time stamps")
    return [output]


def _metadata(source: Source) -> dict[str, Any]:
    wavelength = source.wavelength_nm
    names = [f"band {band}" for band in source.bands]
    channel: dict[str, Any] = {"Name": names}
    if wavelength is not None:
        channel = {"Name": [f"{nm:.1f} nm" for nm in wavelength]}
        if (wavelength > 0).all():
            channel |= {"EmissionWavelength": wavelength.tolist(), "EmissionWavelengthUnit": ["nm"] * len(wavelength)}
    metadata: dict[str, Any] = {
        "axes": "CYX",
        "Name": source.name,
        "Description": source.summary,
        "Channel": channel,
        "MapAnnotation": {
            "quantity": source.quantity,
            "saturation": str(source.saturation),
            "missing lines": " ".join(str(line) for line in np.flatnonzero(source.missing)),
            "simulated": str(source.simulated),
        },
    }
    if source.significant_bits is not None:
        metadata["SignificantBits"] = source.significant_bits
    return metadata

"""What other people's readers look for in a cube: OME-Zarr 0.5 and CF attributes.

OME-Zarr (ngff.openmicroscopy.org/0.5) wants channels before the axes of space, and axes named as the dimensions of the array:
(band, line, sample) is such an order. CF names quantities, units and flags.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, Final

X_ATTRIBUTES: Final = {
    "standard_name": "projection_x_coordinate",
    "long_name": "position along the slit",
    "units": "mm",
    "axis": "X",
}
"""Of an array ``x`` (sample), or (line, sample)."""

Y_ATTRIBUTES: Final = {
    "standard_name": "projection_y_coordinate",
    "long_name": "position across the slit",
    "units": "mm",
    "axis": "Y",
}
"""Of an array ``y`` (line), or (line, sample)."""


def root_attributes(pitch_mm: tuple[float, float] | None = None) -> dict[str, Any]:
    """Attributes of the group by which readers of CF and OME-Zarr recognise it.

    Args:
        pitch_mm: Distance of two lines, and of two samples, where they are known and even.
    """
    return {
        "Conventions": "CF-1.11",
        "title": "line-scan hyperspectral cube",
        "source": f"scanhsi {version('scanhsi')}",
        "ome": ome_attributes(pitch_mm),
    }


def ome_attributes(pitch_mm: tuple[float, float] | None = None) -> dict[str, Any]:
    """The ``ome`` attribute: one image, of one resolution, in the array ``cube``. See `root_attributes`."""
    unit = {} if pitch_mm is None else {"unit": "millimeter"}
    return {
        "version": "0.5",
        "multiscales": [
            {
                "name": "cube",
                "axes": [
                    {"name": "band", "type": "channel"},
                    {"name": "line", "type": "space", **unit},
                    {"name": "sample", "type": "space", **unit},
                ],
                "datasets": [
                    {
                        "path": "cube",
                        "coordinateTransformations": [{"type": "scale", "scale": [1.0, *(pitch_mm or (1.0, 1.0))]}],
                    }
                ],
            }
        ],
    }

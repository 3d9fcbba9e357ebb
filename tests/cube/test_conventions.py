"""The OME-Zarr and CF attributes of cubes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr
from ome_zarr_models.v05 import Image

from scanhsi import clock
from scanhsi.cube.conventions import ome_attributes
from scanhsi.cube.layout import CubeSpec
from support.cubes import write_cube


def test_a_validator_accepts_cubes(tmp_path: Path) -> None:
    spec = CubeSpec(9, 5, 6, "uint16", 12, {"simulated": True}, np.linspace(400, 800, 5))
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, spec, reach=7, lines_per_shard=4), virtual=True)
    group = zarr.open_group(path, mode="r")
    image = Image.from_zarr(group)
    (multiscale,) = image.ome_attributes.multiscales
    assert [axis.name for axis in multiscale.axes] == ["band", "line", "sample"]
    assert [axis.type for axis in multiscale.axes] == ["channel", "space", "space"]
    assert group.attrs["Conventions"] == "CF-1.11"
    assert str(group.attrs["source"]).startswith("scanhsi ")


def test_scale_is_in_millimetres_where_it_is_known(tmp_path: Path) -> None:
    group = zarr.create_group(tmp_path / "cube.zarr", attributes={"ome": ome_attributes((0.2, 0.1))})
    group.create_array("cube", shape=(3, 4, 5), dtype="uint16", dimension_names=("band", "line", "sample"))
    (multiscale,) = Image.from_zarr(group).ome_attributes.multiscales
    assert [axis.unit for axis in multiscale.axes] == [None, "millimeter", "millimeter"]
    assert multiscale.datasets[0].coordinateTransformations[0].scale == [1.0, 0.2, 0.1]


def test_the_validator_can_refuse() -> None:
    from ome_zarr_models.v05.multiscales import Multiscale

    (multiscale,) = ome_attributes()["multiscales"]
    multiscale["axes"] = [multiscale["axes"][index] for index in (1, 0, 2)]
    with pytest.raises(ValueError, match="space axes must be at the end"):
        Multiscale.model_validate(multiscale)

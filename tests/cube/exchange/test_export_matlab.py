"""MAT-files, opened by Octave and scipy (version 5), Octave and h5py (7.3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from scanhsi import ConfigError, export_cube
from scanhsi.cube.exchange import matlab
from support.exports import make_cube, octave, pixels_of

WAVELENGTH_NM = np.linspace(400.1, 1000.7, 5)
KINDS = [
    pytest.param("uint8", 8, (5, 7, 3), "uint8", id="8-bit"),
    pytest.param("uint16", 12, (5, 7, 3), "uint16", id="12-bit"),
    pytest.param("uint32", 20, (5, 7, 3), "uint32", id="sums"),
    pytest.param("float32", None, (5, 7, 3), "single", id="reflectance"),
    pytest.param("uint16", 12, (1, 7, 3), "uint16", id="one-band"),
    pytest.param("uint8", 8, (5, 1, 3), "uint8", id="one-line"),
]
SHOW = """
s = load('c.mat'); disp(class(s.cube)); disp([size(s.cube, 1) size(s.cube, 2) size(s.cube, 3)]);
printf('%.9g ', s.cube(:)); printf('\\n'); printf('%.17g ', s.wavelength); printf('\\n'); printf('%d ', s.missing);
"""


@pytest.mark.parametrize("version", ["5", "7.3"])
@pytest.mark.parametrize(("dtype", "bits", "shape", "array_class"), KINDS)
def test_octave(
    tmp_path: Path, version: Any, dtype: str, bits: int | None, shape: tuple[int, int, int], array_class: str
) -> None:
    bands, lines, samples = shape
    pixels = pixels_of(shape, dtype, bits)
    cube = make_cube(tmp_path / "c.zarr", pixels, bits=bits, wavelength_nm=WAVELENGTH_NM[:bands])
    export_cube(cube, tmp_path / "c.mat", matlab=version)
    told = octave(SHOW, tmp_path).splitlines()
    # Octave makes double of every float in a file that it takes for HDF5; MATLAB goes by MATLAB_class.
    assert told[0] == ("double" if (version, dtype) == ("7.3", "float32") else array_class)
    assert [int(word) for word in told[1].split()] == [lines, samples, bands]
    in_order = pixels.transpose(1, 2, 0).ravel(order="F")
    np.testing.assert_array_equal(np.array(told[2].split(), float).astype(dtype), in_order)
    assert [float(word) for word in told[3].split()] == WAVELENGTH_NM[:bands].tolist()


def test_scipy_reads_version_5(tmp_path: Path) -> None:
    pixels = pixels_of((5, 6, 4), "uint16", 12)
    make_cube(tmp_path / "c.zarr", pixels, missing={3: "lost"}, attributes={"simulated": True})
    export_cube(tmp_path / "c.zarr", tmp_path / "c.mat")
    found = scipy.io.loadmat(tmp_path / "c.mat")
    pixels[:, 3] = 0
    np.testing.assert_array_equal(found["cube"], pixels.transpose(1, 2, 0))
    assert found["cube"].dtype == np.uint16
    assert found["missing"].tolist() == [[4]]
    assert found["saturation"].tolist() == [[4095]]
    np.testing.assert_array_equal(found["status"].ravel(), [1, 1, 1, 2, 1, 1])
    np.testing.assert_array_equal(found["mirror_step"].ravel()[:3], [100, 102, 104])
    assert found["title"].item().startswith("SIMULATED c.zarr")


def test_version_73_is_marked_as_matlab_wants_it(tmp_path: Path) -> None:
    pixels = pixels_of((5, 6, 4), "uint16", 12)
    make_cube(tmp_path / "c.zarr", pixels)
    export_cube(tmp_path / "c.zarr", tmp_path / "c.mat", matlab="7.3")
    head = (tmp_path / "c.mat").read_bytes()[:512]
    assert head.startswith(b"MATLAB 7.3 MAT-file")
    assert head[124:128] == b"\x00\x02IM"
    with h5py.File(tmp_path / "c.mat", "r") as file:
        assert file["cube"].attrs["MATLAB_class"] == b"uint16"
        np.testing.assert_array_equal(file["cube"][...], pixels.transpose(0, 2, 1))
        assert file["missing"].attrs["MATLAB_empty"] == 1
        assert bytes(file["title"][...].astype("<u2").tobytes()).decode("utf-16-le").startswith("c.zarr")


def test_beyond_2_gb_it_is_version_73(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_cube(tmp_path / "c.zarr", pixels_of((5, 6, 4), "uint16", 12))
    monkeypatch.setattr(matlab, "_LARGEST", 240)
    export_cube(tmp_path / "c.zarr", tmp_path / "c.mat")
    assert (tmp_path / "c.mat").read_bytes().startswith(b"MATLAB 7.3")
    with pytest.raises(ConfigError, match="ends at 2 GB"):
        export_cube(tmp_path / "c.zarr", tmp_path / "d.mat", matlab="5")
    assert not (tmp_path / "d.mat").exists()


def test_planes_that_do_not_fit_a_block_come_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scanhsi.cube.exchange import source

    monkeypatch.setattr(source, "BLOCK_BYTES", 100)
    pixels = pixels_of((5, 30, 8), "uint16", 12)
    export_cube(make_cube(tmp_path / "c.zarr", pixels), tmp_path / "c.mat")
    np.testing.assert_array_equal(scipy.io.loadmat(tmp_path / "c.mat")["cube"], pixels.transpose(1, 2, 0))

"""What is exported and imported again is the same to the bit; and neither takes more memory for a larger cube."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi import export_cube, import_cube, open_cube
from scanhsi.cube.reader import cube_summary, read_records
from support.exports import make_cube, pixels_of

KINDS = [("uint8", 8), ("uint8", 5), ("uint16", 12), ("uint16", 16), ("uint32", 19), ("float32", None)]


@settings(max_examples=15, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 6), st.integers(1, 9), st.integers(1, 7)),
    kind=st.sampled_from(KINDS),
    ending=st.sampled_from(["bil", "bsq", "bip", "nc"]),
    missing=st.sets(st.integers(0, 8)),
    calibrated=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_bit_exact(
    shape: tuple[int, int, int],
    kind: tuple[str, int | None],
    ending: str,
    missing: set[int],
    calibrated: bool,
    seed: int,
) -> None:
    pixels = pixels_of(shape, kind[0], kind[1], seed, saturated=0.4)
    lost = {line: "lost" for line in missing if line < shape[1]}
    wavelength_nm = np.random.default_rng(seed).uniform(300, 2500, shape[0]) if calibrated else None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_cube(folder / "a.zarr", pixels, bits=kind[1], missing=lost, wavelength_nm=wavelength_nm)
        export_cube(folder / "a.zarr", folder / f"x.{ending}")
        import_cube(folder / f"x.{ending}", folder / "b.zarr")
        before, after = open_cube(folder / "a.zarr"), open_cube(folder / "b.zarr")
        assert before["cube"].dtype == after["cube"].dtype
        assert before["cube"].values.tobytes() == after["cube"].values.tobytes()
        np.testing.assert_array_equal(before["status"].values, after["status"].values)
        assert ("wavelength" in after.coords) == calibrated
        if calibrated:
            np.testing.assert_array_equal(before["wavelength"].values, after["wavelength"].values)
        for key in ("valid_max", "significant_bits", "units", "long_name"):
            assert before["cube"].attrs.get(key) == after["cube"].attrs.get(key)
        if ending == "nc":
            assert cube_summary(folder / "b.zarr").missing_reasons == lost


def test_netcdf_brings_the_records_back(tmp_path: Path) -> None:
    make_cube(tmp_path / "a.zarr", pixels_of((3, 9, 4), "uint16", 12), missing={4: "lost"})
    export_cube(tmp_path / "a.zarr", tmp_path / "x.nc")
    import_cube(tmp_path / "x.nc", tmp_path / "b.zarr")
    before, after = read_records(tmp_path / "a.zarr"), read_records(tmp_path / "b.zarr")
    for name in ("mirror_step", "mirror_angle_rad", "frame_id", "device_ns"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    np.testing.assert_array_equal(open_cube(tmp_path / "a.zarr")["time"], open_cube(tmp_path / "b.zarr")["time"])
    taken = before.status == 1
    for stage in ("commanded", "moved", "received"):
        apart = [(r.stamps[stage] - r.stamps["exposure_start"])[taken] for r in (before, after)]
        np.testing.assert_array_equal(*apart)


MEASURE = """
import resource, sys
import numpy as np
from pathlib import Path
from support.exports import make_cube
from scanhsi import export_cube, import_cube
from scanhsi.cube.exchange import importing, source

source.BLOCK_BYTES = importing._BLOCK_BYTES = 8_000_000
folder, lines = Path(sys.argv[1]), int(sys.argv[2])
make_cube(folder / "c.zarr", np.broadcast_to(np.arange(400, dtype=np.uint16), (250, lines, 400)), lines_per_shard=16)
for name in ("c.bil", "d.bsq", "c.nc", "c.mat", "c.ome.tif"):
    export_cube(folder / "c.zarr", folder / name)
import_cube(folder / "d.bsq", folder / "back.zarr")
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


@pytest.mark.soak
@pytest.mark.timeout(110)
def test_memory_does_not_grow_with_the_cube(tmp_path: Path) -> None:
    """100 MB more of cube may cost no more than noise; holding it would cost all of them."""
    peaks: list[float] = []
    for lines in (128, 640):
        folder = tmp_path / str(lines)
        folder.mkdir()
        command = [sys.executable, "-c", MEASURE, str(folder), str(lines)]
        environment = {"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": "", "MALLOC_ARENA_MAX": "2"}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=100)
        assert done.returncode == 0, done.stderr
        peaks.append(float(done.stdout))
    assert peaks[1] < peaks[0] + 60, peaks

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.test_process import spec, steps, write
from scanhsi.calibration.saturation import Histogram, TopCounts
from scanhsi.cube.exchange.exporting import export_cube
from scanhsi.cube.reader import cube_summary, open_cube
from scanhsi.processing import process

LINES = 45


@given(seed=st.integers(0, 1000), plateau=st.sampled_from([None, 3000, 3500]), parts=st.integers(1, 4))
@settings(max_examples=50, deadline=None)
def test_the_upper_end_tells_what_the_whole_histogram_tells(seed, plateau, parts):
    rng = np.random.default_rng(seed)
    frames = [rng.normal(rng.uniform(100, 3000), 300, (40, 50)).clip(0, 4095).astype(np.uint16) for _ in range(6)]
    if plateau:
        frames = [np.minimum(frame, plateau) for frame in frames]
    whole, tops = Histogram(4095), [TopCounts(4095) for _ in range(parts)]
    for index, frame in enumerate(frames):
        whole.add(frame)
        tops[index % parts].add(frame)
    sum_of_all = TopCounts(4095)
    for part in tops:
        sum_of_all.merge(part)
    assert sum_of_all.plateau() == whole.plateau()
    assert sum_of_all.total == whole.counts.sum()


@pytest.fixture
def cubes(tmp_path):
    rng = np.random.default_rng(1)
    write(tmp_path / "dark.zarr", spec(8), 60 + rng.integers(0, 9, (23, 8, 40)))
    write(tmp_path / "white.zarr", spec(8), 3000 + rng.integers(0, 99, (23, 8, 40)))
    light = rng.integers(100, 3900, (23, LINES, 40))
    light[:, :24] = np.minimum(light[:, :24], 2000)
    light[4, 30:35, 3:30] = 4000
    write(tmp_path / "hand.zarr", spec(LINES), np.minimum(light, 3600))
    return tmp_path


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_plateau_below_full_scale_is_found_and_masked_and_exported_as_no_value(cubes, interrupted):
    chain = steps(cubes)[:3]
    if interrupted:
        with pytest.raises(ZeroDivisionError):
            process(cubes / "hand.zarr", cubes / "out.zarr", chain, threads=1, progress=lambda *_: 1 // 0)
        assert not cube_summary(cubes / "out.zarr").complete
    process(cubes / "hand.zarr", cubes / "out.zarr", chain, resume=interrupted)
    raw, out = open_cube(cubes / "hand.zarr"), open_cube(cubes / "out.zarr")
    saturated = raw["cube"].values >= 3600
    assert saturated.sum() > 100
    np.testing.assert_array_equal(np.isnan(out["cube"].values), saturated)
    assert out.attrs["saturation"] == {"level": 3600.0, "from": "plateau"}
    assert out.attrs["complete"] is True
    export_cube(cubes / "out.zarr", cubes / "out.img")
    header = (cubes / "out.hdr").read_text()
    assert "data ignore value" in header


def test_without_a_plateau_full_scale_is_the_level(cubes):
    raw = open_cube(cubes / "hand.zarr")["cube"].values.astype(int)
    raw[4, 30, 3] = 4095
    write(cubes / "full.zarr", spec(LINES), raw)
    process(cubes / "full.zarr", cubes / "out.zarr", steps(cubes)[:2])
    assert open_cube(cubes / "out.zarr").attrs["saturation"] == {"level": 4095.0, "from": "full scale"}

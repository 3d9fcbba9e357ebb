"""Sums of neighbours that cannot overflow, on their way into a cube."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi import clock
from scanhsi.cube.binning import Binning, bin_lines, sum_type
from scanhsi.cube.layout import CubeSpec, choose_layout
from scanhsi.cube.reader import cube_summary, open_cube
from support.cubes import whole, write_cube


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([("uint8", 8), ("uint16", 12), ("uint16", 16)]),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(9, 40), st.integers(9, 40)),
)
def test_sums_are_exact_at_full_scale(kind: tuple[str, int], factors: tuple[int, int], size: tuple[int, int]) -> None:
    dtype, bits = kind
    spec = CubeSpec(3, *size, dtype, bits, binning=Binning(*factors))
    stored = spec.stored
    rng = np.random.default_rng(1)
    lines = rng.integers(2**bits - 3, 2**bits, (3, *size)).astype(dtype)  # nearly all at the top
    out = np.empty((3, stored.bands, stored.samples), stored.dtype)
    bin_lines(lines, spec.binning, out)
    bands, samples = stored.bands * factors[0], stored.samples * factors[1]
    expected = lines[:, :bands, :samples].astype(np.int64)
    expected = expected.reshape(3, stored.bands, factors[0], stored.samples, factors[1]).sum(axis=(2, 4))
    np.testing.assert_array_equal(out, expected)
    assert stored.significant_bits is not None
    assert expected.max() < 2**stored.significant_bits


def test_types_of_the_paper() -> None:
    """Five pixels a channel: 12 bits become 15, which still fit uint16."""
    stored = CubeSpec(10, 1088, 1200, "uint16", 12, {}, np.arange(1088.0), binning=Binning(5)).stored
    assert (stored.bands, stored.samples, stored.dtype, stored.significant_bits) == (217, 1200, "uint16", 15)
    assert stored.wavelength_nm is not None
    np.testing.assert_array_equal(stored.wavelength_nm[:2], [2, 7])
    assert sum_type(65_536) == np.uint32
    with pytest.raises(ValueError, match="bin less"):
        sum_type(2**32)


def test_what_cannot_be_binned() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        Binning(0)
    with pytest.raises(ValueError, match="exceed the frame"):
        CubeSpec(1, 4, 4, "uint8", 8, binning=Binning(5))
    with pytest.raises(ValueError, match="float32"):
        CubeSpec(1, 4, 4, "float32", None, binning=Binning(2))


def test_slots_stay_small_for_binned_cubes() -> None:
    """It is frames as the camera sends them that are in memory."""
    plain = CubeSpec(1200, 1088, 1200, "uint16", 12)
    binned = CubeSpec(1200, 1088, 1200, "uint16", 12, binning=Binning(5))
    assert choose_layout(binned).lines_per_shard == choose_layout(plain).lines_per_shard
    assert choose_layout(binned).shard[0] >= 217


def test_a_binned_cube_says_so(tmp_path: Path) -> None:
    wavelength = np.linspace(400, 800, 11)
    spec = CubeSpec(9, 11, 7, "uint16", 12, {}, wavelength, binning=Binning(3, 2))
    clock.run(write_cube(tmp_path / "c", spec, lines_per_shard=4, missing={5: "lost"}), virtual=True)
    dataset = open_cube(tmp_path / "c")
    expected = whole(spec, 9)[:9, :, :6].astype(np.int64).reshape(3, 3, 9, 3, 2).sum(axis=(1, 4))
    expected[:, 5] = 0
    np.testing.assert_array_equal(dataset["cube"].values, expected)
    np.testing.assert_allclose(dataset["wavelength"].values, wavelength[:9].reshape(3, 3).mean(axis=1))
    assert dataset.attrs["binning"] == {"bands": 3, "samples": 2, "operation": "sum"}
    assert dataset["cube"].attrs["long_name"] == "sums of 6 raw camera counts"
    assert cube_summary(tmp_path / "c").significant_bits == 15

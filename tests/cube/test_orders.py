"""Any sizes, any pattern of missing lines, any end: what is read is what was written."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi import clock
from scanhsi.cube import durable
from scanhsi.cube.layout import CubeSpec, choose_layout
from scanhsi.cube.reader import open_cube, read_records
from support.cubes import whole, write_cube


@st.composite
def scans(draw: st.DrawFn) -> tuple[CubeSpec, int, int, dict[int, str]]:
    lines = draw(st.integers(1, 24))
    dtype, bits = draw(st.sampled_from([("uint8", 8), ("uint16", 12), ("uint16", 16)]))
    spec = CubeSpec(lines, draw(st.integers(1, 40)), draw(st.integers(1, 12)), dtype, bits)
    missing = draw(st.dictionaries(st.integers(0, lines - 1), st.text(min_size=1, max_size=4)))
    return spec, draw(st.integers(1, 9)), draw(st.integers(0, lines)), missing


@settings(max_examples=25, deadline=None)
@given(scans())
def test_any_scan(scan: tuple[CubeSpec, int, int, dict[int, str]]) -> None:
    spec, lines_per_shard, reach, missing = scan
    folder = Path(tempfile.mkdtemp())
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(durable.os, "fsync", lambda _: None)
            clock.run(
                write_cube(folder / "c", spec, reach=reach, missing=missing, lines_per_shard=lines_per_shard),
                virtual=True,
            )
        dataset, records = open_cube(folder / "c"), read_records(folder / "c")
        assert dataset.sizes["line"] == records.lines == reach
        reached_missing = {line: reason for line, reason in missing.items() if line < reach}
        assert records.missing == reached_missing
        if reach:
            expected = whole(spec, reach)
            expected[:, list(reached_missing), :] = 0
            np.testing.assert_array_equal(dataset["cube"].values, expected)
    finally:
        shutil.rmtree(folder)


@given(
    st.integers(1, 3000), st.integers(1, 3000), st.integers(1, 3000), st.sampled_from([("uint8", 8), ("uint16", 12)])
)
def test_layout_rules(lines: int, bands: int, samples: int, kind: tuple[str, int]) -> None:
    spec = CubeSpec(lines, bands, samples, *kind)
    layout = choose_layout(spec)
    assert all(shard % chunk == 0 for shard, chunk in zip(layout.shard, layout.chunk, strict=True))
    assert layout.shard[0] >= bands
    assert layout.shard[2] >= samples
    padded = layout.shard[0] * layout.shard[2] / (bands * samples)
    assert padded < 1.3 or bands * samples < 3000
    assert layout.lines_per_shard <= min(64, lines)
    assert np.prod(layout.chunk) * spec.line_bytes / (bands * samples) < 2_000_000


def test_layout_of_known_instruments() -> None:
    def layout(bands: int, samples: int, dtype: str) -> tuple[int, tuple[int, int, int]]:
        chosen = choose_layout(CubeSpec(1200, bands, samples, dtype, 8))
        return chosen.lines_per_shard, chosen.chunk

    assert layout(1088, 2048, "uint16") == (16, (32, 16, 512))
    assert layout(1088, 1200, "uint16") == (16, (32, 16, 400))
    assert layout(217, 1200, "uint16") == (64, (16, 32, 400))
    assert layout(1088, 1200, "uint8") == (32, (16, 32, 400))

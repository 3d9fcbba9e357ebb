"""``scanhsi verify``."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from support.command_line import Cli
from support.cubes import write_cube


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    path = tmp_path / "cube.zarr"
    spec = CubeSpec(23, 9, 14, "uint16", 12)
    clock.run(write_cube(path, spec, lines_per_shard=6, missing={2: "lost", 9: "late"}), virtual=True)
    return path


def test_command(cube: Path, cli: Cli) -> None:
    good = cli("verify", cube)
    assert good.code == 0
    assert "21 stored lines" in good.out
    (cube / "cube/c/0/1/0").write_bytes(b"torn")
    (cube / ".x.partial").write_text("")
    bad = cli("verify", cube, "--json")
    assert bad.code == 4
    assert bad.object["bad_lines"] == [6, 7, 8, 10, 11]
    assert bad.object["problems"][0]["file"] == "cube/c/0/1/0"
    assert bad.object["repair"] is None
    told = cli("verify", cube)
    assert told.code == 4
    assert "5 lines of" in told.out
    assert "6 to 8, 10 to 11" in told.out
    assert "--repair --mark-unreadable" in told.out
    assert "would remove" in cli("verify", cube, "--repair", "--dry-run").out
    assert (cube / ".x.partial").exists()
    assert cli("verify", cube, "--repair").code == 4
    assert not (cube / ".x.partial").exists()
    mended = cli("verify", cube, "--repair", "--mark-unreadable")
    assert mended.code == 0
    assert "mark 5 lines as missing (6 to 8, 10 to 11)" in mended.out
    assert cli("verify", cube).code == 0
    assert cli("verify", cube, "--dry-run").code == 2
    assert cli("verify", cube.parent).code == 4

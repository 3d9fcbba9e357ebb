"""A small simulated instrument."""

from pathlib import Path

import pytest

from support.command_line import MINI


@pytest.fixture
def mini(tmp_path: Path) -> Path:
    path = tmp_path / "mini.toml"
    path.write_text(MINI)
    return path

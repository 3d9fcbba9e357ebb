"""A server of victims, and a file system that fails on command."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.faults import FaultyFs
from support.victims import Victims


@pytest.fixture(scope="session")
def victims() -> Iterator[Victims]:
    with Victims() as server:
        yield server


@pytest.fixture(scope="session")
def faulty_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FaultyFs]:
    with FaultyFs(tmp_path_factory.mktemp("faulty")) as server:
        yield server


@pytest.fixture
def faulty(faulty_server: FaultyFs) -> Iterator[FaultyFs]:
    yield faulty_server
    faulty_server.clear()


def cube_of(folder: Path) -> Path:
    return folder / "cube.zarr"


@pytest.fixture
def no_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resuming in this process asks no real disk to sync: here processes die, not computers, and syncing takes most of the time."""
    monkeypatch.setattr(os, "fsync", lambda _: None)

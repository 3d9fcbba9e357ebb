"""One S3 server for the tests of a session, and its environment."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest

from scanhsi.cube.location import locate
from scanhsi.cube.object_destination import ObjectDestination
from support.seaweed import S3, seaweed


@pytest.fixture(scope="session")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3]:
    with seaweed(tmp_path_factory.mktemp("s3") / "server") as running:
        yield running


@pytest.fixture
def server(s3: S3, monkeypatch: pytest.MonkeyPatch) -> S3:
    """The server, with what a client needs in the environment."""
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    return s3


@pytest.fixture
def url(server: S3) -> str:
    """Of a cube that is not there yet."""
    return f"s3://{server.bucket}/{uuid4().hex}/cube.zarr"


@pytest.fixture
def destination(url: str) -> Iterator[ObjectDestination]:
    made = ObjectDestination(locate(url), retry_s=5)
    yield made
    made.unlock()


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """Where what is in the bucket is copied to, to be looked at."""
    return tmp_path / "copy.zarr"

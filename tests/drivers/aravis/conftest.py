"""Camera twins for tests marked `twin`."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from aravis_twin import Twin


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    """A twin for all tests of a module."""
    running = Twin(tmp_path_factory.mktemp("twin"))
    yield running
    running.close()


@pytest.fixture
def own_twin(tmp_path: Path) -> Iterator[Twin]:
    """A twin that the test may kill; not in one module with `twin`, there is one address."""
    running = Twin(tmp_path)
    yield running
    running.close()

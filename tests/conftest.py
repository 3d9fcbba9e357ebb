"""What every test may use."""

from collections.abc import Generator

import pytest

from scanhsi_sim import bench

pytest_plugins = ["support.namespace"]


@pytest.fixture(autouse=True)
def own_benches() -> Generator[None]:
    """A test that leaves devices on a simulated bench leaves them to nobody: the next one finds an empty bench."""
    yield
    bench._benches.clear()

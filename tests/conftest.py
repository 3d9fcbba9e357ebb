"""What every test may use."""

import gc
from collections.abc import Generator
from typing import Any

import pytest

from scanhsi_sim import bench

pytest_plugins = ["support.namespace"]

gc.disable()  # until the tests are collected: hardly anything of that is garbage

ONE_SERVER = "tests/cube/object_storage/"
"""These tests share an S3 server, which takes longer to start and to end than they take."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Among processes (``-n 3``) tests are shared out file by file, for what a file has made once."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return ONE_SERVER if nodeid.startswith(ONE_SERVER) else nodeid.partition("::")[0]

    return ByFile(config, log)


def pytest_collection_finish() -> None:
    """Thousands of tests, and the modules, are there to stay: the garbage collector need not look at them again and again."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def own_benches() -> Generator[None]:
    """A test that leaves devices on a simulated bench leaves them to nobody: the next one finds an empty bench."""
    yield
    bench._benches.clear()

"""These tests are about contents: waiting for the disk after each of thousands of small files would be most of their time."""

import os
from collections.abc import Generator

import pytest


@pytest.fixture(autouse=True, scope="module")
def no_syncs() -> Generator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("fsync", "fdatasync"):
            patch.setattr(os, name, lambda _: None)
        yield

"""Fake cameras for tests marked `twin`, which run in a private network."""

from collections.abc import Iterator

import pytest

from support.genicam_fake import FakeCamera


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeCamera]:
    """A camera for all tests of a module."""
    running = FakeCamera()
    yield running
    running.close()

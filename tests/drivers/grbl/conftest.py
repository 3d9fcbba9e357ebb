"""Names what the emulator needs before a test trips over it."""

import os

import pytest

from scanhsi_sim.twins.stepper_build import missing_tools


@pytest.fixture(autouse=True)
def _emulator(request: pytest.FixtureRequest) -> None:
    """Skip a test of the emulator where it cannot be built; fail it where CI is set."""
    problem = missing_tools() if request.node.get_closest_marker("twin") else None
    if problem:
        (pytest.fail if "CI" in os.environ else pytest.skip)(f"the stepper's emulator: {problem}")

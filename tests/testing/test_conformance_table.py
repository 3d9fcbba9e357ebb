"""The table of promises and tests names every test of the suites, and no other."""

import re
from pathlib import Path

import pytest

from scanhsi.testing.conformance import ActuatorConformance, CameraConformance, LightConformance

TABLE = Path(__file__).parents[2] / "docs/reference/conformance.md"


@pytest.mark.parametrize(
    ("title", "suite"),
    [("Cameras", CameraConformance), ("Actuators", ActuatorConformance), ("Lights", LightConformance)],
)
def test_the_table_is_whole(title, suite):
    (section,) = [part for part in TABLE.read_text().split("\n## ") if part.startswith(title)]
    named = set(re.findall(r"`(test_\w+)`", section))
    assert named == {name for name in dir(suite) if name.startswith("test_")}

"""The driver of "Write a driver" passes the suite, as the page says."""

import re
from pathlib import Path
from typing import Any

from scanhsi.testing.conformance import ActuatorConformance

PAGE = Path(__file__).parents[2] / "docs/how-to/write-a-driver.md"
WRITTEN: dict[str, Any] = {"__name__": "documented"}
exec(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0], WRITTEN)


class TestDocumentedStage(ActuatorConformance):
    virtual = True
    exclusive = False

    def make(self):
        return WRITTEN["Stage"](WRITTEN["StageOptions"](port="/dev/null"))

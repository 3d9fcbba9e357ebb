"""Running command lines in this process, and a small simulated instrument."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MINI = """
[camera]
driver = "simulated"
profile = "ideal"
scene = "testpattern"
bands = 8
samples = 16
[actuator]
driver = "simulated"
profile = "ideal"
[geometry]
distance = "350 mm"
normal_step = 0
[scan]
lines = 6
exposure = "20 ms"
"""


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str

    @property
    def object(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        (line,) = self.out.splitlines()
        return json.loads(line)


Cli = Callable[..., Result]

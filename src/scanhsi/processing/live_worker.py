"""The process beside a scan: ``python -m scanhsi.processing.live_worker JOB``; see `scanhsi.processing.live`."""

from __future__ import annotations

import json
import os
import pickle
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from scanhsi.devices.errors import ScanhsiError
from scanhsi.processing.follow import Followed, follow, is_over
from scanhsi.processing.live import LiveProcessing

_NICER: Final = 19
"""It takes what the scan, and everything else, leaves of the processors."""


def main() -> None:
    """Follow a scan until standard input ends; print the outcome as one JSON object."""
    os.nice(_NICER)
    job = Path(sys.argv[1])
    cube, live = pickle.loads(job.read_bytes())  # made by `Following.start`, in a file that nobody else can write
    job.unlink()
    try:
        told: dict[str, Any] = asdict(_follow(cube, live))
    except ScanhsiError as error:
        told = {"error": str(error)}
    sys.stdout.write(json.dumps(told))


def _follow(cube: str, live: LiveProcessing) -> Followed:
    return follow(cube, live.output, live.steps, codec=live.codec, over=is_over(sys.stdin.fileno()))


if __name__ == "__main__":
    main()

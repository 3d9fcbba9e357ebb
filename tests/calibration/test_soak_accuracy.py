"""Every number of docs/explanation/calibration-accuracy.md, from simulated acquisitions, with fewer seeds; some minutes."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[1] / "benchmarks/accuracy"


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", ["sensor", "emva", "wavelength", "mirror"])
def test_what_calibrations_reach(part: str) -> None:
    command = [sys.executable, str(BENCHMARK), part, "--seeds", "8"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1700)
    assert done.returncode == 0, done.stdout + done.stderr

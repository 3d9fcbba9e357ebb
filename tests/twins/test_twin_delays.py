"""The loop of measured delays, closed: a scan of the twins is recorded, and its replay in virtual time is that scan again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import scanhsi
from scanhsi import clock
from scanhsi.cli import run
from scanhsi.cube.reader import read_records
from scanhsi.instrument import load_instrument
from scanhsi.timing.delays import load_profile
from scanhsi.timing.observed import Stamps, exposure_starts
from scanhsi.timing.recording import Recording, measured_ns
from scanhsi_sim.twins.rig import TwinRig

pytestmark = [pytest.mark.twin, pytest.mark.timeout(180)]

PLAN = {"lines": 400, "mode": "stepped", "step": 2, "exposure": "10 ms", "pixel_format": "Mono8"}


def scan_twin(output: Path) -> None:
    async def main() -> scanhsi.ScanReport:
        async with TwinRig(scene="testpattern") as rig:
            config = load_instrument("twin", {"actuator.port": rig.port, "camera.address": rig.camera_address})
            async with scanhsi.open_instrument(config) as hsi:
                return await hsi.scan(hsi.default_plan(**PLAN), output)

    assert clock.run(main()).missing == 0


def test_a_replay_of_a_twin_scan_is_that_scan_again(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Each delay that a device spends is a recorded one, to the nanosecond. What queues behind them (copies, and so lines) is the
    same within the scatter of the replays: a busy computer's few bursts come more often in one than in another."""
    scan_twin(tmp_path / "twin.zarr")
    profile = tmp_path / "twin.json"
    assert run(["delays", "record", str(tmp_path / "twin.zarr"), "-o", str(profile)]) == 0
    assert load_profile(profile).mark.startswith("SIMULATED")
    measured = read_records(tmp_path / "twin.zarr").stamps
    replays = [replayed(profile, tmp_path / f"{seed}.zarr", seed) for seed in range(8)]
    periods = [float(np.diff(exposure_starts(stamps)).mean()) for stamps in replays]
    period = float(np.diff(exposure_starts(measured)).mean())
    record_property("period_ms", [period * 1e-6, *(each * 1e-6 for each in periods)])
    assert np.mean(periods) == pytest.approx(period, abs=0.02 * period + 3 * standard_error(periods))
    wanted, found = samples(measured), [samples(stamps) for stamps in replays]
    for name in ("T_act", "T_ev", "T_rx"):
        assert np.isin(np.concatenate([each[name] for each in found]), wanted[name]).all(), name
    for name in ("line", "T_act", "T_ev", "T_rx", "T_mcpy"):
        for part in (0.5, 0.95):
            levels = [float(np.mean(each[name] <= np.quantile(wanted[name], part))) for each in found]
            record_property(f"{name} {part}", levels)
            assert np.mean(levels) == pytest.approx(part, abs=0.05 + 3 * standard_error(levels)), name


def standard_error(values: list[float]) -> float:
    return float(np.std(values, ddof=1)) / len(values) ** 0.5


def replayed(profile: Path, output: Path, seed: int) -> Stamps:
    """A scan of the paper's instrument, small, with the delays of the twin."""
    config = load_instrument("sensors2019", {"camera.scene": "white", "roi.samples": 16, "roi.bands": 8})

    async def main() -> None:
        async with scanhsi.open_instrument(config, seed=seed, delays=profile) as hsi:
            await hsi.scan(hsi.default_plan(**PLAN), output)

    clock.run(main(), virtual=True)
    return read_records(output).stamps


def samples(stamps: Stamps) -> dict[str, NDArray[np.int64]]:
    """Delays by stream, and from line to line."""
    delays = measured_ns(Recording(stamps, 10_000_000, "Mono8", 2, "stepped"))
    present = {str(stream): column[column >= 0] for stream, column in delays.items()}
    return {**present, "line": np.diff(exposure_starts(stamps))}

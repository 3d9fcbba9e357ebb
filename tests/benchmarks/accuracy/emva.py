"""Photon transfer of a simulated acquisition, beside what emva1288 makes of the same frames (see `support.emva`)."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from rows import Row, acquire

from scanhsi.calibration.frames import frames_of
from scanhsi.calibration.photon_transfer import FlatPair, photon_transfer
from scanhsi.calibration.result import Provenance
from scanhsi.cube.reader import open_cube

sys.path.append(str(Path(__file__).parents[2]))
from support.emva import emva1288, emva_python

EVEN = {  # bands where the spectrum is flattest, no vignetting, no hot pixels: EMVA wants an even light
    "roi.samples": 1200,
    "roi.sample_offset": 424,
    "roi.bands": 40,
    "roi.band_offset": 408,
    "camera.optics.vignetting": 0.0,
    "camera.sensor.hot_per_million": 0.0,
    "camera.lamp.flicker": 0.0,
    "camera.optics.smile_px": 0.0,
}


def taken(folder: Path) -> list[FlatPair]:
    """The pairs of a protocol that kept its cubes."""
    frames: dict[str, dict[float, np.ndarray]] = {"flat": {}, "dark": {}}
    for cube in folder.iterdir():
        dataset = open_cube(cube, chunks=None)
        kind = "dark" if dataset.attrs["target"] == "dark" else "flat"
        frames[kind][dataset.attrs["plan"]["exposure_s"]] = np.stack(list(frames_of(dataset, str(cube))))
    return [FlatPair(t, frames["flat"][t], frames["dark"][t]) for t in sorted(frames["flat"])]


def rows(seeds: int) -> list[Row]:
    if emva_python() is None:
        return [Row("photon transfer by emva1288", "", "not installed: EMVA1288_PYTHON names no environment")]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ptc.nc"
        _, true, config = acquire(EVEN, lambda hsi: hsi.calibrate.photon_transfer(path))
        pairs = taken(Path(folder) / "ptc-cubes")
    ours = photon_transfer(pairs, Provenance())
    half = int(np.argmin(np.abs(ours.signal - ours.signal.max() / 2)))
    theirs = emva1288(pairs[: int(np.argmax(ours.variance)) + 2], half)
    sensor = config.camera.options.sensor
    table = [
        ("gain K", ours.gain, theirs["K"], true.gain()),
        ("read noise, e-", ours.read_noise_e, theirs["sigma_d"], true.read_noise_e),
        ("saturation, e-", ours.saturation_e, theirs["u_e_sat"], true.full_well_e),
        ("SNR at saturation, dB", ours.snr_max_db, theirs["SNR_max_dB"], 10 * np.log10(true.full_well_e)),
        ("dynamic range, dB", ours.dynamic_range_db, theirs["DR_dB"], 20 * np.log10(true.full_well_e / (13 + 0.5))),
        ("DSNU, e-", ours.dsnu_e, theirs["DSNU1288"], sensor.dsnu_e),
        ("PRNU, %", 100 * ours.prnu, theirs["PRNU1288"], 100 * sensor.prnu),
    ]
    return [
        Row(
            f"{name}: ours; emva1288 of the same frames",
            f"{real:.5g}",
            f"{one:.5g}; {other:.5g}",
            abs(one / other - 1) < 0.03,
        )
        for name, one, other, real in table
    ]

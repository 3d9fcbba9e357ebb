"""OpenHSI's processing of the same lines: ``python openhsi_processing.py FRAMES.npy LEVEL``, in an environment that has openhsi.

Level 4 is its crop, smile (whole pixels), binning (sums), dark signal and one factor; 6 divides by another spectrum after that.
Lines are in memory, as (sample, band), the order that it works in. Prints one JSON object. For ``scanhsi bench processing``.
"""

import json
import os
import sys
import time
from importlib.metadata import version

import numpy as np
import xarray as xr

LEAST_S = 2.0
EXPOSURE_MS = 20.0


def calibration(samples: int, bands: int) -> dict[str, object]:
    """Made up, as the references of ours are."""
    rng = np.random.default_rng(2)
    wavelengths = np.linspace(371.0, 948.0, bands)
    dark, white = (level + 5 * rng.standard_normal((samples, bands)) for level in (60.0, 3000.0))
    slit = np.linspace(-1, 1, samples)
    return {
        "wavelengths": wavelengths,
        "wavelengths_linear": wavelengths,
        "smile_shifts": np.rint(0.2 * (slit + 1) + 0.8 * slit**2).astype(int),
        "rad_ref": xr.DataArray(
            np.stack((dark, white))[None],
            dims=("exposure", "luminance", "cross_track", "wavelength_index"),
            coords={"exposure": [EXPOSURE_MS], "luminance": [0, 10_000]},
        ),
        "sfit": lambda nm: np.ones_like(nm),
        "rad_fit": lambda nm: np.ones_like(nm),
        "spec_rad_ref_luminance": 10_000,
        "flat_field_pic": white.astype(np.uint16),
    }


def main() -> None:
    out = os.dup(1)
    os.dup2(2, 1)  # what it prints is not the result
    from openhsi.data import CircArrayBuffer, DataCube

    frames, level = np.load(sys.argv[1]), int(sys.argv[2])
    lines = [np.ascontiguousarray(frame.T) for frame in frames]
    samples, bands = lines[0].shape
    cube = DataCube(n_lines=len(lines), processing_lvl=-1, warn_mem_use=False)
    cube.settings = {
        "row_slice": [0, samples],
        "resolution": [samples, bands],
        "pixel_format": "Mono12",
        "exposure_ms": EXPOSURE_MS,
        "fwhm_nm": 5.01 * 577 / bands,  # five bands a channel
        "luminance": 10_000,
    }
    cube.calibration = calibration(samples, bands)
    cube.set_processing_lvl(level)
    cube.dc = CircArrayBuffer((cube.dc_shape[0], len(lines), cube.dc_shape[1]), axis=1, dtype=np.float32)
    best, passed = np.inf, 0.0
    while passed < LEAST_S:
        began = time.perf_counter()
        for line in lines:
            cube.put(line)
        took = time.perf_counter() - began
        best, passed = min(best, took), passed + took
    versions = {name: version(name) for name in ("openhsi", "numpy")}
    told = {"ms_a_line": 1e3 * best / len(lines), "channels": cube.dc_shape[1], "versions": versions}
    os.write(out, json.dumps(told).encode())


if __name__ == "__main__":
    main()

"""OpenHSI: ``collect()`` of its simulated camera, raw frames into memory; then, where asked, xarray to Zarr. It moves nothing."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from openhsi.cameras import SimulatedCamera
from work import BLOCK, SHAPE, Watch, Work


def scan(work: Work, watch: Watch) -> np.ndarray | None:
    return _scan(work, watch, "flat")


def scan_picture(work: Work, watch: Watch) -> np.ndarray | None:
    return _scan(work, watch, None)


class Camera(SimulatedCamera):
    """The simulated camera, on the watch."""

    watch: Watch

    def get_img(self) -> np.ndarray:
        image = super().get_img()
        self.watch.line_over()
        return image


def _scan(work: Work, watch: Watch, mode: str | None) -> np.ndarray | None:
    with tempfile.TemporaryDirectory() as folder:
        camera = Camera(mode=mode, n_lines=work.lines, processing_lvl=-1, **_files(Path(folder)))
    camera.watch = watch
    with watch.running():
        camera.collect()
        if work.store is not None:
            blocks = {"chunks": (SHAPE[1], SHAPE[0], BLOCK), "compressors": None}  # (wavelength, x, y)
            camera.to_xarray().to_zarr(work.store, encoding={"datacube": blocks}, zarr_format=3, consolidated=False)
    if work.store is None:
        return None
    return xr.open_zarr(work.store, consolidated=False)["datacube"].transpose("y", "x", "wavelength").to_numpy()


def _files(folder: Path) -> dict[str, str]:
    """Settings and a calibration, made up: the package ships none."""
    settings = {"resolution": list(SHAPE), "row_slice": [0, SHAPE[0]], "pixel_format": "Mono16", "exposure_ms": 0}
    (folder / "settings.json").write_text(json.dumps(settings), encoding="utf-8")
    wavelengths = np.linspace(400.0, 900.0, SHAPE[1])
    xr.Dataset({"wavelengths": ("wavelengths_dim", wavelengths)}).to_netcdf(folder / "calibration.nc")
    return {"json_path": str(folder / "settings.json"), "cal_path": str(folder / "calibration.nc")}

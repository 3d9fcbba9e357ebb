"""Every kind of result, by the name in its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, cast

import xarray as xr

from scanhsi.calibration.backlash import Backlash
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.repeatability import Repeatability
from scanhsi.calibration.resolution import BarContrast, EdgeResponse
from scanhsi.calibration.result import Result, load, unreadable
from scanhsi.calibration.smile import Smile
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.calibration.white import WhiteReference
from scanhsi.devices.errors import CalibrationError

KINDS: Final[dict[str, type[Any]]] = {
    kind.kind: kind
    for kind in (
        DarkModel,
        WhiteReference,
        PhotonTransfer,
        SignalToNoise,
        Wavelength,
        Smile,
        Keystone,
        LightStability,
        Geometry,
        Jitter,
        Backlash,
        Repeatability,
        EdgeResponse,
        BarContrast,
    )
}


def is_result(path: str | Path) -> bool:
    """Whether a path looks like a stored result rather than a cube: a file, not a folder or a URL."""
    return "://" not in str(path) and Path(path).is_file()


def load_any(path: str | Path) -> Result:
    """Read a result of whatever kind.

    Raises:
        CalibrationError: The file is missing, no result, or of a kind that this scanhsi does not know.
    """
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            kind = dataset.attrs.get("scanhsi_calibration")
    except (OSError, ValueError) as error:
        raise unreadable(path) from error
    if kind not in KINDS:
        raise CalibrationError(
            f"{path} holds {f'a {kind} result' if kind else 'no calibration'}, which this scanhsi does not know."
        )
    return cast("Result", load(KINDS[kind], path))

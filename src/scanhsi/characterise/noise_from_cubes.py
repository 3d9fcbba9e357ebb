"""Photon transfer, signal to noise and stability of the light, from cubes of a white tile and dark ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.frames import FrameStack, frames_of, stack_frames
from scanhsi.calibration.light import LightStability, light_stability
from scanhsi.calibration.photon_transfer import FlatPair, PhotonTransfer, photon_transfer
from scanhsi.calibration.snr import Moments, SignalToNoise, signal_to_noise_of
from scanhsi.characterise.from_cubes import (
    check_dark,
    exposure_of,
    opened,
    provenance_of,
    split_by_target,
)
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Path_ = str | Path

_SMOOTH: Final = (7, 31)
"""Pixels (bands, samples) over which light is taken to be smooth: narrower than any vignetting, wider than one pixel's response."""

_EVEN: Final = (0.97, 0.94, 0.9, 0.8, 0.7)
_ENOUGH: Final = 2000
_LIT: Final = 0.4  # of the brightest light: enough to see shot noise


def photon_transfer_from_cubes(cubes: Sequence[Path_]) -> PhotonTransfer:
    """Photon transfer of the best lit part of the frame.

    Args:
        cubes: Dark ones and such of a flat light, two lines of each at every exposure.

    Raises:
        CalibrationError: An exposure lacks one of the two; see `photon_transfer`.
    """
    dark, flat = (
        {exposure_of(ds, name): _pair(ds, name) for ds, name in _named(part)} for part in split_by_target(cubes)
    )
    if set(dark) != set(flat):
        lonely = ", ".join(f"{exposure:g} s" for exposure in sorted(set(dark) ^ set(flat)))
        raise CalibrationError(f"flat and dark cubes are needed at the same exposures; one is missing at {lonely}.")
    pairs = [FlatPair(exposure, flat[exposure], dark[exposure]) for exposure in sorted(flat)]
    if not pairs:
        raise CalibrationError("there are no flat cubes.")
    light, good = _light(pairs), _alike(pairs)
    region = _best_lit(light, good)
    lit = good & (light >= _LIT * light.max())
    return photon_transfer(pairs, provenance_of(opened(cubes), cubes), mask=region, light=light, lit=lit)


def _named(cubes: Sequence[Path_]) -> list[tuple[xr.Dataset, str]]:
    return [(dataset, str(cube)) for dataset, cube in zip(opened(cubes), cubes, strict=True)] if cubes else []


def _pair(dataset: xr.Dataset, name: str) -> NDArray[Any]:
    frames: list[NDArray[Any]] = []
    for frame in frames_of(dataset, name):
        frames.append(frame)
        if len(frames) == 2:
            return np.stack(frames)
    raise CalibrationError(f"{name} holds a single line; photon transfer needs two.")


def _light(pairs: Sequence[FlatPair]) -> Floats:
    """The light on the pixels, smooth: of the exposure that comes nearest to half of the largest signal."""
    signals = [pair.flat.mean(axis=0, dtype=np.float64) - pair.dark.mean(axis=0, dtype=np.float64) for pair in pairs]
    levels = np.array([np.quantile(signal, 0.99) for signal in signals])
    half = signals[int(np.argmin(np.abs(levels - levels.max() / 2)))]
    for axis, size in enumerate(_SMOOTH):
        half = np.asarray(ndimage.uniform_filter1d(half, size, axis=axis), np.float64)
    return np.maximum(half, 1e-9)


def _alike(pairs: Sequence[FlatPair]) -> NDArray[np.bool_]:
    """Pixels whose dark counts at the longest exposure are like those of the others: hot ones saturate by themselves."""
    dark = pairs[-1].dark.mean(axis=0, dtype=np.float64)
    median = float(np.median(dark))
    spread = 1.4826 * float(np.median(np.abs(dark - median)))
    return np.abs(dark - median) <= 10 * max(spread, 0.5)


def _best_lit(light: Floats, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The brightest part that is large enough: pixels that are lit alike saturate together."""
    top = float(light.max())
    for share in _EVEN:
        region = (light >= share * top) & good
        if region.sum() >= _ENOUGH:
            break
    return region  # pyright: ignore[reportPossiblyUnboundVariable] _EVEN is not empty


def snr_from_cubes(
    cubes: Sequence[Path_], *, dark: DarkModel | None = None, tile: float = 0.99, saturation: float | None = None
) -> SignalToNoise:
    """Signal to noise of a white tile, as reflectance, by exposure and band.

    Args:
        cubes: Of the tile, one an exposure, 20 lines or more each; dark ones of the same exposures too, where there is no model.
        dark: Dark model instead of dark cubes.
        tile: Reflectance of the tile.
        saturation: Counts from which a pixel is saturated; None finds it.

    Raises:
        CalibrationError: The dark signal of an exposure is missing, or does not apply.
    """
    below, white = ([], list(cubes)) if dark is not None else split_by_target(cubes)
    darks = {_exposure(stack): stack.mean for stack in map(stack_frames, below)}
    moments: dict[float, Moments] = {}
    for cube in white:
        stack = stack_frames(cube, saturation=saturation)
        exposure = _exposure(stack)
        if dark is not None:
            check_dark(dark, stack.conditions)
        elif exposure not in darks:
            raise CalibrationError(f"there is no dark cube of {exposure:g} s for {cube}.")
        moments[exposure] = _reflectances(stack, dark.at(exposure) if dark is not None else darks[exposure], tile)
    return signal_to_noise_of(moments, provenance_of(opened(cubes), cubes))


def _exposure(stack: FrameStack) -> float:
    if stack.conditions.exposure_s is None:
        raise CalibrationError(f"{stack.source} does not say at which exposure it was taken.")
    return stack.conditions.exposure_s


def _reflectances(stack: FrameStack, dark: Floats, tile: float) -> Moments:
    """Counts as the reflectance of the tile: the mean is the tile's, the noise in proportion."""
    signal = np.where(stack.saturated, np.nan, stack.mean - dark)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.where(signal > 0, tile * stack.sigma / signal, np.nan)
    return Moments(np.where(np.isfinite(sigma), tile, np.nan), sigma, stack.lines)


def light_from_cubes(
    cubes: Sequence[Path_], *, dark: DarkModel | None = None, on_before_s: float = 0.0
) -> LightStability:
    """Stability of the light from snapshots of a white tile.

    Args:
        cubes: Of the tile, one a snapshot, eight or more, of one exposure; with a dark one among them where there is no model.
        dark: Dark model instead of a dark cube.
        on_before_s: How long the lamp was on before the first snapshot.

    Raises:
        CalibrationError: No dark signal; see `light_stability`.
    """
    below, snapshots = ([], list(cubes)) if dark is not None else split_by_target(cubes)
    if dark is None and len(below) != 1:
        raise CalibrationError(
            f"light stability needs one dark cube among its cubes, or a dark model; not {len(below)}."
        )
    datasets = opened(snapshots)
    if len({exposure_of(dataset, cube) for dataset, cube in zip(datasets, snapshots, strict=True)}) != 1:
        raise CalibrationError("the snapshots were not all taken at the same exposure.")
    exposure_s = exposure_of(datasets[0], snapshots[0])
    if dark is not None:
        check_dark(dark, Conditions.of(datasets[0].attrs))
    black = dark.at(exposure_s) if dark is not None else stack_frames(below[0]).mean
    good = np.ones(black.shape, bool)
    for cube in snapshots:  # twice through the cubes, so that memory does not grow with their number
        good &= ~stack_frames(cube).saturated
    signals = np.array([float((stack_frames(cube).mean - black)[good].mean()) for cube in snapshots])
    times = np.array([_time_s(dataset) for dataset in datasets])
    order = np.argsort(times)
    times = times - times.min() + on_before_s
    return light_stability(times[order], signals[order], provenance_of(opened(cubes), cubes))


def _time_s(dataset: xr.Dataset) -> float:
    """Middle of the cube on the clock of the computer; of simulated ones on the clock of their run, which may be virtual."""
    simulated = dataset.attrs.get("simulated") is True
    stamps = np.asarray(dataset["exposure_start_ns" if simulated else "time"].values).astype(np.int64)
    return float(stamps.astype(np.float64).mean()) * 1e-9

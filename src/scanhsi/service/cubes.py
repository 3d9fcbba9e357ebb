"""Cubes as viewers see them. Blocking functions, run in threads of low priority; bounded memory."""

from __future__ import annotations

import io
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from PIL import Image

from scanhsi.calibration.view import view
from scanhsi.cube.reader import CubeSummary, cube_summary, open_cube
from scanhsi.cube.spectra import random_spectra, region_spectrum, stored
from scanhsi.devices.errors import ConfigError, CubeError
from scanhsi.service.jobs import plain
from scanhsi.service.models import CubeEntry, CubeInfo, SpectraModel, SpectrumModel

_LONGEST_SIDE: Final = 1000
_REGION_VALUES: Final = 64_000_000
"""Values read at once for the mean over a region."""


def entry(path: Path) -> CubeEntry:
    """A cube in the list."""
    return CubeEntry(**_entry(path, cube_summary(path)))


def info(path: Path) -> CubeInfo:
    """A cube, with what it says of itself."""
    summary = cube_summary(path)
    return CubeInfo(
        **_entry(path, summary),
        significant_bits=summary.significant_bits,
        wavelength_nm=_wavelengths(open_cube(path, chunks=None)),
        missing_reasons=summary.missing_reasons,
        attributes=plain(summary.attributes),
    )


def _entry(path: Path, summary: CubeSummary) -> dict[str, Any]:
    modified = datetime.fromtimestamp((path / "zarr.json").stat().st_mtime, UTC)
    target = summary.attributes.get("target")
    return {
        "id": path.name,
        "bands": summary.shape[0],
        "lines": summary.shape[1],
        "samples": summary.shape[2],
        "lines_planned": summary.lines_planned,
        "lines_stored": summary.lines_stored,
        "lines_missing": summary.lines_missing,
        "complete": summary.complete,
        "simulated": summary.simulated,
        "dtype": summary.dtype,
        "size_bytes": summary.size_bytes,
        "modified": modified.isoformat(timespec="seconds"),
        "target": str(target) if target else None,
    }


def _wavelengths(dataset: xr.Dataset) -> list[float] | None:
    return plain(dataset["wavelength"].values.tolist()) if "wavelength" in dataset.variables else None


def colour_png(path: Path) -> bytes:
    """The colour picture; transparent where no line is stored."""
    colour = view(path).colour
    shown = np.isfinite(colour).all(axis=2)
    rgba = np.empty((*colour.shape[:2], 4), np.uint8)
    rgba[..., :3] = np.round(255 * np.clip(np.nan_to_num(colour), 0, 1)).astype(np.uint8)
    rgba[..., 3] = np.where(shown, 255, 0)
    return png(rgba)


def band_png(path: Path, *, wavelength_nm: float | None, band: int | None) -> tuple[bytes, dict[str, str]]:
    """One band in grey, stretched from its 1st to its 99.5th percentile; transparent where no line is stored.

    Returns:
        The picture, and what it shows, as headers.

    Raises:
        ConfigError: No such band, or a wavelength of a cube that has none.
    """
    dataset = open_cube(path, chunks=None)
    index = band if band is not None else _nearest(dataset, wavelength_nm)
    if not 0 <= index < dataset.sizes["band"]:
        raise ConfigError(f"band {index}: the cube has bands 0 to {dataset.sizes['band'] - 1}.")
    by_line, by_sample = (max(1, -(-dataset.sizes[axis] // _LONGEST_SIDE)) for axis in ("line", "sample"))
    values = np.asarray(dataset["cube"].isel(band=index).values, np.float32)[::by_line, ::by_sample]
    shown = stored(dataset)[::by_line]
    if not shown.any():
        raise CubeError(f"{path.name} holds no line: there is nothing to see.")
    low, high = (float(level) for level in np.nanpercentile(values[shown], [1.0, 99.5]))
    grey = np.round(255 * np.clip((values - low) / max(high - low, 1e-6), 0, 1))
    pixels = np.stack([np.nan_to_num(grey), np.broadcast_to(255 * shown[:, None], grey.shape)], axis=-1)
    told = {"Scanhsi-Band": str(index), "Scanhsi-Range": f"{low:g} {high:g}"}
    if "wavelength" in dataset.variables:
        told["Scanhsi-Wavelength"] = f"{float(dataset['wavelength'].values[index]):.2f}"
    return png(pixels.astype(np.uint8)), told


def _nearest(dataset: xr.Dataset, wavelength_nm: float | None) -> int:
    if wavelength_nm is None:
        raise ConfigError("say which band: wavelength_nm, or band.")
    if "wavelength" not in dataset.variables:
        raise ConfigError("the cube has no wavelengths.", hint="band, by its index")
    return int(np.abs(dataset["wavelength"].values - wavelength_nm).argmin())


def spectrum(path: Path, lines: tuple[int, int], samples: tuple[int, int]) -> SpectrumModel:
    """Mean and spread over a region; ends are left out. Missing lines are not counted.

    Raises:
        ConfigError: It is empty, lies outside of the cube, or is too large to be read for a viewer.
        CubeError: None of its lines is stored.
    """
    dataset = open_cube(path, chunks=None)
    _inside(dataset, "line", lines)
    _inside(dataset, "sample", samples)
    bands = dataset.sizes["band"]
    if bands * (lines[1] - lines[0]) * (samples[1] - samples[0]) > _REGION_VALUES:
        most = _REGION_VALUES // bands
        raise ConfigError(f"the region has more than {most} pixels.", hint="a smaller one, or download the cube")
    region = region_spectrum(dataset, slice(*lines), slice(*samples))
    return SpectrumModel(
        cube=path.name,
        quantity=_quantity(dataset),
        wavelength_nm=_wavelengths(dataset),
        mean=plain(region.mean.tolist()),
        sigma=plain(region.sigma.tolist()),
        pixels=int(region.count.max()),
    )


def several(path: Path, count: int, seed: int) -> SpectraModel:
    """Spectra of pixels drawn at random from the stored lines.

    Raises:
        CubeError: No line is stored.
    """
    dataset = open_cube(path, chunks=None)
    found = random_spectra(dataset, count, seed=seed)
    return SpectraModel(
        cube=path.name,
        quantity=_quantity(dataset),
        wavelength_nm=_wavelengths(dataset),
        lines=found.lines.tolist(),
        samples=found.samples.tolist(),
        spectra=plain(found.values.tolist()),
    )


def _inside(dataset: xr.Dataset, axis: str, ends: tuple[int, int]) -> None:
    if not 0 <= ends[0] < ends[1] <= dataset.sizes[axis]:
        raise ConfigError(f"{axis}s {ends[0]} to {ends[1] - 1}: the cube has {axis}s 0 to {dataset.sizes[axis] - 1}.")


def _quantity(dataset: xr.Dataset) -> str:
    return str(dataset["cube"].attrs.get("long_name", "")) if dataset["cube"].dtype.kind == "f" else "counts"


def png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG of (rows, columns, channels): grey and alpha, or colour and alpha."""
    file = io.BytesIO()
    Image.fromarray(pixels, {2: "LA", 4: "RGBA"}[pixels.shape[2]]).save(file, "PNG", compress_level=3)
    return file.getvalue()

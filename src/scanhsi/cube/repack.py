"""Repacking: a cube that was written as fast as the disk took it (raw) becomes one that is small and quick to read."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import xarray as xr

from scanhsi.cube.durable import PARTIAL, LocalDestination, sync_directory
from scanhsi.cube.layout import CubeSpec, choose_layout
from scanhsi.cube.metadata import ROOT, Documents, decoded
from scanhsi.cube.reader import cube_summary
from scanhsi.cube.rewrite import Progress, Rewriting, attributes_of, coordinates_of, open_source
from scanhsi.cube.shards import Codec
from scanhsi.devices.errors import CubeError, CubeExists

_PICTURE = "quicklook"


@dataclass(frozen=True, slots=True)
class Repacked:
    """What repacking came to.

    Attributes:
        path: Of the repacked cube.
        bytes_before, bytes_after: On disk.
        replaced: Whether the old cube is gone.
    """

    path: str
    bytes_before: int
    bytes_after: int
    replaced: bool


def repack(
    cube: str | Path,
    output: str | Path | None = None,
    *,
    codec: Codec = "lz4",
    threads: int = 2,
    progress: Progress | None = None,
) -> Repacked:
    """Write a cube anew, compressed and cut into small chunks; every shard is read again and compared before it counts.

    Without ``output`` the old cube is replaced: the new one is built beside it (``<name>.repacking``), and only once all of it is
    on disk do the two change places. Interrupted at any time, the same call goes on; the old cube stands until then.

    Args:
        cube: The cube: closed, on a local disk.
        output: Folder of the new cube, which must not exist; the old one stays then.
        codec: Of the new cube.
        threads: So many.
        progress: Told after every shard.

    Raises:
        NotACube, CubeExists, CubeError: A cube cannot be read or written, or a shard did not read back as it was. The old cube is
            as it was.
    """
    path = Path(cube)
    target = Path(output) if output is not None else path.with_name(f"{path.name}.repacking")
    keep = output is not None
    if not keep:
        _finish_swap(path, target)
        for leftover in path.parent.glob(f".{target.name}.*{PARTIAL}"):  # of a process that was killed as it began
            shutil.rmtree(leftover)
    source = open_source(path)
    if not cast("dict[str, Any]", source.attrs.get("acquisition") or {}).get("finished"):
        raise CubeError(
            f"{path} was never closed.", hint="finish the scan, or resume it, first; or scanhsi verify --repair"
        )
    if keep and target.exists():
        raise CubeExists(f"{target} exists already; nothing was written.", hint="another name, or move it away first")
    before = cube_summary(path).size_bytes
    rewriting = _rewriting(source, path, target, codec)
    rewriting.run(threads=threads, resume=not keep, progress=progress)
    _copy_picture(path, target)
    after = cube_summary(target).size_bytes
    if not keep:
        _swap(path, target)
    return Repacked(str(target if keep else path), before, after, not keep)


def _rewriting(source: xr.Dataset, path: Path, target: Path, codec: Codec) -> Rewriting:
    pixels = source["cube"]
    encoding = pixels.encoding
    wavelength = source["wavelength"].values if "wavelength" in source.coords else None
    standard = ("valid_min", "valid_max", "significant_bits", "coordinates")
    bits = pixels.attrs.get("significant_bits")
    spec = CubeSpec(
        lines=source.sizes["line"],
        bands=source.sizes["band"],
        samples=source.sizes["sample"],
        dtype=pixels.dtype,
        significant_bits=None if bits is None else int(bits),
        attributes=attributes_of(source),
        wavelength_nm=wavelength,
        pixel_attributes={key: str(value) for key, value in pixels.attrs.items() if key not in standard},
        coordinates=coordinates_of(source),
    )
    lines = (encoding.get("shards") or encoding["chunks"])[1]
    documents = decoded((path / ROOT).read_bytes())
    picture: Documents = {}
    key = f"{_PICTURE}/{ROOT}"
    if key in documents:
        picture = {key: documents[key]}
    layout = choose_layout(spec, lines, whole_frames=codec == "raw")
    return Rewriting(source, target, spec, layout, codec, check=True, arrays=picture)


def _copy_picture(path: Path, target: Path) -> None:
    """Copy the quicklook: its files are its values, and stay as they are."""
    old, new = LocalDestination(path), LocalDestination(target)
    contents = {key: old.get(key) for key in old.keys(f"{_PICTURE}/c")}
    new.put_all({key: data for key, data in contents.items() if data is not None}, durable=True)


def _swap(path: Path, target: Path) -> None:
    """Put the new cube in the place of the old one."""
    try:
        path.rename(_replaced(path))
        _finish_swap(path, target)
    except OSError as error:
        raise CubeError(
            f"{target} is whole, but cannot take the place of {path}: {error.strerror or error}.",
            hint="repack again, or move it",
        ) from error


def _finish_swap(path: Path, target: Path) -> None:
    """Go on where a swap stands: the old cube aside, the new one in its place, the old one gone."""
    replaced = _replaced(path)
    if not replaced.exists():
        return
    if not path.exists():
        target.rename(path)
        sync_directory(path.parent)
    shutil.rmtree(replaced)


def _replaced(path: Path) -> Path:
    return path.with_name(f".{path.name}.replaced")

"""Files that appear under their names when they are whole, and never replace one."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import uuid
from collections.abc import Generator
from pathlib import Path

from scanhsi.cube.durable import sync_directory
from scanhsi.devices.errors import CubeError, CubeExists


@contextlib.contextmanager
def new_files(*paths: Path) -> Generator[list[Path]]:
    """Write files in one go: yields temporary names beside them; afterwards all appear, the first one last, or none does.

    Raises:
        CubeExists: One of them is there already; nothing was touched.
        CubeError: The folder is missing or not writable, the disk is full; nothing is left behind.
    """
    for path in paths:
        refuse_existing(path)
    unique = uuid.uuid4().hex
    temporary = [path.with_name(f".{path.name}.{unique}.partial") for path in paths]
    try:
        yield temporary
        for file in temporary:
            _sync(file)
        _publish(list(zip(temporary, paths, strict=True))[::-1])
        sync_directory(paths[0].parent)
    except OSError as error:
        raise output_error(paths[0], error) from error
    finally:
        for file in temporary:
            with contextlib.suppress(OSError):
                file.unlink(missing_ok=True)


def refuse_existing(path: Path) -> None:
    """Raise `CubeExists` if there is something under a name, `CubeError` if there is no folder for it."""
    if path.exists() or path.is_symlink():
        raise CubeExists(f"{path} exists already; nothing was written.", hint="another name, or move it away first")
    if not path.parent.is_dir():
        raise CubeError(f"there is no folder {path.parent} to write into.", hint=f"mkdir -p {path.parent}")


def _publish(moves: list[tuple[Path, Path]]) -> None:
    done: list[Path] = []
    try:
        for file, path in moves:
            _rename_new(file, path)
            done.append(path)
    except BaseException:
        for path in done:
            path.unlink(missing_ok=True)
        raise


def _rename_new(file: Path, path: Path) -> None:
    """Rename, but not over something that came meanwhile. Where the file system has no hard links it can only look first."""
    try:
        path.hardlink_to(file)
    except FileExistsError:
        raise CubeExists(f"{path} exists by now; it was not touched.", hint="another name") from None
    except OSError:
        refuse_existing(path)
        file.rename(path)
    else:
        file.unlink()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def output_error(path: Path, error: OSError) -> CubeError:
    """An error of the file system, as the user needs to read it."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        free = shutil.disk_usage(path.parent).free
        return CubeError(
            f"the disk that shall hold {path} is full ({free / 1e6:.1f} MB are free); nothing of it was kept.",
            hint="another disk, fewer lines or bands, or a compressed format (.nc)",
        )
    return CubeError(f"cannot write {path}: {error.strerror or error}.")

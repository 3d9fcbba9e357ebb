"""The data folder: names in it, and nothing outside of it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Final

from scanhsi.devices.errors import ConfigError, CubeExists
from scanhsi.service.downloads import TEMPORARY
from scanhsi.service.refusals import NoSuch

NAME: Final = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$"
"""Names that may stand in a request: no separator, no leading dot."""
_NAME: Final = re.compile(NAME)


class Folder:
    """A folder of cubes (``*.zarr``), results of calibrations (``*.nc``) and recipes.

    Args:
        root: Created where missing.
    """

    def __init__(self, root: Path) -> None:
        root.mkdir(parents=True, exist_ok=True)
        self.root = root.resolve()
        for left in self.root.glob(f"{TEMPORARY}*"):  # of downloads of a service that was killed
            shutil.rmtree(left, ignore_errors=True)

    @property
    def free_bytes(self) -> int:
        """On the disk."""
        return shutil.disk_usage(self.root).free

    def new(self, name: str, ending: str) -> Path:
        """Path of something to be made.

        Raises:
            ConfigError: The name may not stand there.
            CubeExists: It is taken.
        """
        name = name if name.endswith(ending) else name + ending
        if not _NAME.fullmatch(name):
            raise ConfigError(f"{name!r} is no name: letters, digits, '.', '_' and '-', 100 at most.")
        path = self.root / name
        if path.exists() or path.is_symlink():
            raise CubeExists(f"{name} exists already; nothing was touched.", hint="another name")
        return path

    def cube(self, name: str) -> Path:
        """Path of a cube.

        Raises:
            NoSuch: There is none of that name.
        """
        path = self._existing(name, "cube", "GET /api/v1/cubes")
        if not (path / "zarr.json").is_file():
            raise NoSuch(f"there is no cube {name}.", hint="GET /api/v1/cubes")
        return path

    def result(self, name: str) -> Path:
        """Path of a result.

        Raises:
            NoSuch: There is none of that name.
        """
        path = self._existing(name, "result", "GET /api/v1/calibrations")
        if path.suffix != ".nc" or not path.is_file():
            raise NoSuch(f"there is no result {name}.", hint="GET /api/v1/calibrations")
        return path

    def file(self, name: str, ending: str) -> Path:
        """Path of a small file of ours; it need not be there.

        Raises:
            NoSuch: The name may not stand there.
        """
        path = self.root / (name + ending)
        if not _NAME.fullmatch(name) or path.is_symlink():
            raise NoSuch(f"there is no {name[:100]!r}.")
        return path

    def files(self, ending: str) -> list[Path]:
        """All files of ours with an ending."""
        return [path for path in self._entries() if path.name.endswith(ending) and path.is_file()]

    def cubes(self) -> list[Path]:
        """All cubes, the youngest first."""
        found = [path for path in self._entries() if (path / "zarr.json").is_file()]
        return sorted(found, key=lambda path: (path / "zarr.json").stat().st_mtime, reverse=True)

    def results(self) -> list[Path]:
        """All results, the youngest first."""
        found = [path for path in self._entries() if path.suffix == ".nc" and path.is_file()]
        return sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)

    def _entries(self) -> list[Path]:
        return [path for path in self.root.iterdir() if _NAME.fullmatch(path.name) and self._inside(path)]

    def _existing(self, name: str, what: str, hint: str) -> Path:
        path = self.root / name
        if not _NAME.fullmatch(name) or not path.exists() or not self._inside(path):
            raise NoSuch(f"there is no {what} {name[:100]!r}.", hint=hint)
        return path

    def _inside(self, path: Path) -> bool:
        """Not a link that leads out."""
        return path.resolve().parent == self.root

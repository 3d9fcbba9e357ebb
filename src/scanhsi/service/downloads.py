"""Cubes on their way out: a Zarr folder as a ZIP made while it is sent, other formats exported first. Blocking functions."""

from __future__ import annotations

import contextlib
import secrets
import shutil
import tempfile
import zipfile
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, Literal, cast

from scanhsi.clock import now_ns
from scanhsi.cube.exchange import export_cube
from scanhsi.service.refusals import NoSuch, TooMany

DownloadFormat = Literal["zarr", "envi", "netcdf", "matlab"]
FORMATS: Final[tuple[DownloadFormat, ...]] = ("zarr", "envi", "netcdf", "matlab")
TICKET_S: Final = 60.0
_MOST_TICKETS: Final = 100
_BLOCK: Final = 1 << 20
_ENDINGS: Final[dict[str, str]] = {"envi": ".bil", "netcdf": ".nc", "matlab": ".mat"}
TEMPORARY: Final = ".download-"


@dataclass(frozen=True, slots=True)
class Download:
    """A file to be sent.

    Attributes:
        name: As the browser saves it.
        media_type: Of it.
        blocks: Its bytes.
    """

    name: str
    media_type: str
    blocks: Generator[bytes]


def download(cube: Path, format: DownloadFormat) -> Download:
    """Begin one. Closing ``blocks`` removes what was made for it.

    Raises:
        CubeError: The cube cannot be read, or the disk is full.
    """
    if format == "zarr":
        return Download(f"{cube.name}.zip", "application/zip", zipped(_files_of(cube)))
    folder = Path(tempfile.mkdtemp(prefix=TEMPORARY, dir=cube.parent))
    try:
        exported = export_cube(cube, folder / f"{cube.stem}{_ENDINGS[format]}")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    paths: list[Path] = list(exported.paths)
    if len(paths) > 1:
        files = [(path.name, path) for path in paths]
        return Download(f"{cube.stem}-{format}.zip", "application/zip", _then_remove(folder, zipped(files)))
    media_type = "application/x-netcdf" if format == "netcdf" else "application/octet-stream"
    return Download(paths[0].name, media_type, _then_remove(folder, _blocks(paths[0])))


def _files_of(cube: Path) -> list[tuple[str, Path]]:
    """Every file of a cube; the status first: of a cube that is being written, what it vouches for is on disk by then."""
    files = sorted(path for path in cube.rglob("*") if path.is_file() and not path.is_symlink())
    named = [(path.relative_to(cube).as_posix(), path) for path in files]
    return sorted(named, key=lambda item: (not item[0].startswith("status/"), item[0]))


class _Sink:
    """What a ZIP is written into; it cannot be rewound, so that nothing has to be kept."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def write(self, data: bytes) -> int:
        """As files do."""
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """As files do."""

    def take(self) -> bytes:
        """What was written since."""
        parts, self._parts = self._parts, []
        return b"".join(parts)


def zipped(files: list[tuple[str, Path]]) -> Generator[bytes]:
    """A ZIP of files, stored as they are; chunks of cubes are compressed already. zarr opens it as a `ZipStore`."""
    sink = _Sink()
    with zipfile.ZipFile(cast("IO[bytes]", sink), "w", zipfile.ZIP_STORED) as archive:  # write and flush are enough
        for name, path in files:
            with contextlib.suppress(FileNotFoundError):  # a temporary file of a writer, gone by now
                size = path.stat().st_size
                with path.open("rb") as source:
                    info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                    info.external_attr = 0o644 << 16
                    with archive.open(info, "w", force_zip64=size > 1 << 30) as entry:
                        while block := source.read(_BLOCK):
                            entry.write(block)
                            yield sink.take()
    yield sink.take()


def _blocks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            yield block


def _then_remove(folder: Path, blocks: Iterator[bytes]) -> Generator[bytes]:
    try:
        yield from blocks
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Tickets:
    """Addresses that a browser may download from once, without the token, which must not stand in an address."""

    def __init__(self) -> None:
        self._open: dict[str, tuple[str, DownloadFormat, int]] = {}

    def issue(self, cube: str, format: DownloadFormat) -> str:
        """A new one.

        Raises:
            TooMany: There are many that nobody used.
        """
        self._forget()
        if len(self._open) >= _MOST_TICKETS:
            raise TooMany("too many downloads are prepared.", hint=f"wait {TICKET_S:g} s")
        ticket = secrets.token_urlsafe(24)
        self._open[ticket] = (cube, format, now_ns() + round(TICKET_S * 1e9))
        return ticket

    def use(self, ticket: str) -> tuple[str, DownloadFormat]:
        """What it is for; it is used up by this.

        Raises:
            NoSuch: It was used, ran out, or never was.
        """
        self._forget()
        found = self._open.pop(ticket, None)
        if found is None:
            raise NoSuch("this download was used or ran out.", hint="prepare it again")
        return found[:2]

    def _forget(self) -> None:
        now = now_ns()
        self._open = {ticket: entry for ticket, entry in self._open.items() if entry[2] > now}

"""A cube made of another one, shard by shard: by threads here, or by the workers of a cluster.

One task makes one shard of the new cube: it reads those lines, computes, writes pixels, then records, then status. So no two
workers ever write one file, memory is a few shards a thread whatever the cube's size, and what was killed goes on where it was.
"""

from __future__ import annotations

import functools
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.cube.buffers import ShardBuffer
from scanhsi.cube.durable import LocalDestination
from scanhsi.cube.layout import RECORDS, STATUS, Coordinate, CubeSpec, Layout
from scanhsi.cube.metadata import ROOT, Documents, decoded
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineStatus
from scanhsi.cube.shards import Codec, CubeFiles, ShardPixels, ShardRecords
from scanhsi.devices.errors import CubeError, CubeExists

if TYPE_CHECKING:
    from distributed import Client

Compute = Callable[[NDArray[Any]], NDArray[Any]]
"""(band, line, sample) of some lines -> the same lines as the new cube has them."""

_KEPT: Final = ("clock_offset_ns", "acquisition", "missing", "incidents", "binning", "resumed")
"""What the files of a cube say besides the attributes of a `CubeSpec`, and a cube made of it says again."""

_LINES_AT_ONCE: Final = 8

_OF_A_SESSION: Final = frozenset({"run", "versions", "devices", "real_time", "incidents"})
"""Attributes of a source that may change while it grows, or when it is resumed."""

_MADE_ANEW: Final = ("Conventions", "ome", "scanhsi_format", "complete", "storage", "title", "source")
_COUNTS: Final = ("lines_planned", "lines_stored", "lines_missing")


Inspect = Callable[[NDArray[Any]], Any]
"""(band, line, sample) of some lines of the source -> what is to be known of them; both go to other processes."""

Progress = Callable[[int, int], None]
"""Told how many bytes of the source's pixels are done, and how many there are."""


def attributes_of(source: xr.Dataset) -> dict[str, Any]:
    """Attributes for the `CubeSpec` of a cube that is made of this one."""
    return {key: value for key, value in source.attrs.items() if key not in (*_KEPT, *_MADE_ANEW, *_COUNTS)}


def coordinates_of(source: xr.Dataset, but: tuple[str, ...] = ()) -> tuple[Coordinate, ...]:
    """Coordinates for the `CubeSpec` of a cube that is made of this one, with the same sizes; some left out by name."""
    there = (source[name] for name in ("x", "y", "wavelength_map") if name in source.coords and name not in but)
    return tuple(
        Coordinate(str(array.name), tuple(map(str, array.dims)), np.asarray(array.values), dict(array.attrs))
        for array in there
    )


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """What follows from all that was seen of a source, told before the new cube counts as complete.

    Attributes:
        attributes: Of the new cube.
        compute: What becomes of the pixels of some shards after all; None if all stay.
        again: First lines of these shards.
    """

    attributes: Mapping[str, Any]
    compute: Compute | None = None
    again: Sequence[int] = ()


@dataclass(frozen=True, eq=False)
class Rewriting:
    """What is to be made of which cube.

    Attributes:
        source: Dataset of `open_cube` with ``chunks=None``.
        target: Folder of the new cube.
        spec: Of the new cube, with as many lines as the source has.
        layout: Of the new cube.
        codec: Of the new cube.
        compute: What becomes of the pixels; None leaves them.
        check: Read every shard again after it was written, and compare.
        arrays: Documents of arrays that the new cube has besides those of every cube.
        inspect: What is to be known of the source, shard by shard.
        review: Draws the conclusions, from the first line of each shard -> what was seen there.
    """

    source: xr.Dataset
    target: Path
    spec: CubeSpec
    layout: Layout
    codec: Codec = "lz4"
    compute: Compute | None = None
    check: bool = False
    arrays: Documents | None = None
    inspect: Inspect | None = None
    review: Callable[[Mapping[int, Any]], Review] | None = None

    def run(
        self,
        *,
        client: Client | None = None,
        threads: int = 2,
        resume: bool = False,
        progress: Progress | None = None,
        seen: Mapping[int, Any] | None = None,
    ) -> None:
        """Make it.

        Args:
            client: Cluster whose workers do it; they must see source and target under the same paths. None: threads here.
            threads: So many, without a cluster.
            resume: Go on with what an interrupted run of the same rewriting left, or of one with fewer lines.
            progress: Told after every shard.
            seen: What was inspected before of shards that are there; the others are read again.

        Raises:
            CubeExists: The target is there, and ``resume`` was not asked for; it was not touched.
            CubeError: It cannot be read or written. What was written stays, marked as not complete.
        """
        files = self.open(resume=resume)
        try:
            found = self._make_shards(files.documents, client, threads, progress, dict(seen or {}))
            ended = {"complete": self._complete, "acquisition": self.source.attrs.get("acquisition", {})}
            if self.review is not None:
                review = self.review(found)
                task = ShardTask(replace(self, compute=review.compute, inspect=None), files.documents)
                for _ in _each(client, task, list(review.again), threads):
                    pass
                ended |= review.attributes
            files.finish(self.spec.lines, {**self.spec.attributes, **self._kept, **ended})
        finally:
            files.destination.unlock()

    def open(self, *, resume: bool = False) -> CubeFiles:
        """Create the new cube, or go on with what is there of it; locked, and not complete.

        Raises:
            CubeExists, CubeError: As `run`.
        """
        destination = LocalDestination(self.target)
        files = CubeFiles(destination, self.spec, self.layout, self.codec)
        if not resume or not (self.target / ROOT).exists():
            files.create(self._head(), self.arrays)
            return files
        documents = self._interrupted(destination)
        try:
            files.reopen(documents, {"complete": False, **self._head()})
        except BaseException:
            destination.unlock()
            raise
        return files

    @property
    def _complete(self) -> bool:
        return self.source.attrs.get("complete") is True

    @property
    def _kept(self) -> dict[str, Any]:
        return {key: self.source.attrs[key] for key in _KEPT if key in self.source.attrs}

    def _head(self) -> dict[str, Any]:
        kept = self._kept
        acquisition = {**cast("dict[str, Any]", kept.get("acquisition") or {}), "finished": None}
        return {**kept, "acquisition": acquisition}

    def _interrupted(self, destination: LocalDestination) -> Documents:
        """Lock what an earlier run left, and read what it is."""
        try:
            destination.lock()
        except BlockingIOError as error:
            raise CubeError(f"{self.target} is being written by another process.") from error
        documents = decoded(destination.get(ROOT) or b"")
        there, (bands, _, samples) = documents[ROOT]["attributes"], documents[f"cube/{ROOT}"]["shape"]
        fixed = self.spec.attributes.keys() - _OF_A_SESSION
        same = all(there.get(key) == self.spec.attributes[key] for key in fixed)
        same = same and there.get("storage", {}).get("codec") == self.codec
        shard = tuple(documents[f"cube/{ROOT}"]["chunk_grid"]["configuration"]["chunk_shape"])
        if not same or (bands, samples) != (self.spec.bands, self.spec.samples) or shard != self.layout.shard:
            destination.unlock()
            raise CubeExists(f"{self.target} is another cube, or was made in another way; it was not touched.")
        return documents

    def _make_shards(
        self,
        documents: Documents,
        client: Client | None,
        threads: int,
        progress: Progress | None,
        found: dict[int, Any],
    ) -> dict[int, Any]:
        """Make what is not there; returns what was seen of all shards."""
        task = ShardTask(self, documents)
        todo = [first for first in self.shards() if not self.is_there(first)]
        unseen = [first for first in self.shards() if self.inspect is not None and first not in {*found, *todo}]
        done = self.spec.lines - sum(self._lines(first) for first in todo)
        line_bytes = self.source["cube"].nbytes // self.spec.lines
        for first, seen in _each(client, task, unseen + todo, threads):
            found[first] = seen
            done += self._lines(first) if first in todo else 0
            if progress is not None:
                progress(done * line_bytes, self.spec.lines * line_bytes)
        return found

    def on(self, source: xr.Dataset) -> Rewriting:
        """The same of a source that has grown."""
        return replace(self, source=source)

    def shards(self) -> range:
        """First lines of the shards."""
        return range(0, self.spec.lines, self.layout.lines_per_shard)

    def _lines(self, first: int) -> int:
        return min(self.layout.lines_per_shard, self.spec.lines - first)

    def is_there(self, first: int) -> bool:
        """Whether a shard is made, of all its lines: its status is written after everything it vouches for."""
        path = self.target / STATUS.name / "c" / str(first // self.layout.lines_per_shard)
        lines = self._lines(first)
        wanted = np.asarray(self.source["status"].values[first : first + lines], np.uint8)
        return path.exists() and path.read_bytes()[:lines] == wanted.tobytes()


class ShardTask:
    """Makes shards; goes to other processes without what it has opened in this one."""

    def __init__(self, rewriting: Rewriting, documents: Documents) -> None:
        self._documents = documents
        self.look_again(rewriting)

    def look_again(self, rewriting: Rewriting) -> None:
        """Go on with a source that has grown."""
        self._rewriting = rewriting
        self._columns = {variable.name: _column(rewriting.source, variable.name, variable.fill) for variable in RECORDS}
        self._status = np.asarray(rewriting.source["status"].values, np.uint8)

    @functools.cached_property
    def _files(self) -> CubeFiles:
        job = self._rewriting
        files = CubeFiles(LocalDestination(job.target), job.spec, job.layout, job.codec)
        files.attach(self._documents)
        return files

    @functools.cached_property
    def _buffers(self) -> queue.SimpleQueue[ShardBuffer]:
        return queue.SimpleQueue()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_files", "_buffers")}

    def __call__(self, first: int) -> Any:
        """Make the shard that begins with line ``first``, if it is not there; returns what was seen of the source there."""
        job = self._rewriting
        lines = slice(first, min(first + job.layout.lines_per_shard, job.spec.lines))
        lost = self._status[lines] == LineStatus.MISSING
        buffer = self._buffer()
        try:
            rows = buffer.rows[: lines.stop - first]
            there, seen = self._make(lines, lost, rows)
            if there:
                return seen
            self._files.write_pixels(ShardPixels(first, buffer, lost))
            if job.check:
                self._compare(lines, rows, lost)
        finally:
            self._buffers.put(buffer)
        columns = {name: column[lines] for name, column in self._columns.items()}
        self._files.write_records(ShardRecords(first, columns, self._status[lines]))
        return seen

    def _make(self, lines: slice, lost: NDArray[np.bool_], rows: NDArray[Any]) -> tuple[bool, Any]:
        """Read lines, look at them, and unless they are made compute some at a time into (line, band, sample).

        What comes out is in memory once, and what went in no longer when this returns whether they are made, and what was seen.
        """
        job = self._rewriting
        pixels = np.asarray(job.source["cube"].isel(line=lines).values)
        seen: Any = None
        if job.inspect is not None:
            seen = job.inspect(pixels[:, ~lost] if lost.any() else pixels)
            if job.is_there(lines.start):
                return True, seen
        for first in range(0, len(rows), _LINES_AT_ONCE):
            some = slice(first, first + _LINES_AT_ONCE)
            made = pixels[:, some] if job.compute is None else job.compute(pixels[:, some])
            rows[some] = made.transpose(1, 0, 2)
        return False, seen

    def _buffer(self) -> ShardBuffer:
        try:
            return self._buffers.get_nowait()
        except queue.Empty:
            return self._files.allocate()

    def _compare(self, lines: slice, rows: NDArray[Any], lost: NDArray[np.bool_]) -> None:
        """Read a shard again. Its status is not written yet, so zarr has to be asked for it by name."""
        import zarr

        array = cast("zarr.Array[Any]", zarr.open_group(self._rewriting.target, mode="r")["cube"])
        again = np.asarray(array[:, lines, :]).transpose(1, 0, 2)
        if not np.array_equal(again[~lost], rows[~lost], equal_nan=rows.dtype.kind == "f"):
            raise CubeError(
                f"lines {lines.start} to {lines.stop - 1} of {self._rewriting.target} read back otherwise than written."
            )


def _column(source: xr.Dataset, name: str, fill: int | float) -> NDArray[Any]:
    """A per-line array as it is stored; cubes of an older scanhsi lack some."""
    if name not in source.variables:
        return np.full(source.sizes["line"], fill)
    values = np.asarray(source[name].values)
    return values.astype(np.int64) if values.dtype.kind == "M" else values


def _each(client: Client | None, task: ShardTask, todo: list[int], threads: int) -> Iterator[tuple[int, Any]]:
    """First lines of shards as they are made, with what was seen of them."""
    return _on_cluster(client, task, todo) if client else _in_threads(task, todo, threads)


def _in_threads(task: ShardTask, todo: list[int], threads: int) -> Iterator[tuple[int, Any]]:
    """Shards as they are made by dask's threads."""
    from dask import threaded  # takes a while

    made: queue.SimpleQueue[tuple[int, Any] | BaseException | None] = queue.SimpleQueue()
    stop = threading.Event()

    def make(first: int) -> None:
        if not stop.is_set():
            made.put((first, task(first)))

    def work() -> None:
        try:
            graph = {f"shard at line {first}": (functools.partial(make, first),) for first in todo}
            threaded.get(graph, list(graph), num_workers=threads)
        except BaseException as error:
            made.put(error)
        else:
            made.put(None)

    worker = threading.Thread(target=work, name="scanhsi-rewrite", daemon=True)
    worker.start()
    try:
        while (one := made.get()) is not None:
            if isinstance(one, BaseException):
                raise one
            yield one
    finally:
        stop.set()
        worker.join()


def _on_cluster(client: Client, task: ShardTask, todo: list[int]) -> Iterator[tuple[int, Any]]:
    """Shards as they are made by the workers of a cluster."""
    from distributed import as_completed

    everywhere = cast("Any", client.scatter(task, broadcast=True, hash=False))
    futures = cast("list[Any]", client.map(_call, todo, task=everywhere, pure=False))
    try:
        for future in cast("Iterator[Any]", as_completed(futures)):
            yield cast("tuple[int, Any]", future.result())
    finally:
        client.cancel(futures)


def _call(first: int, task: ShardTask) -> tuple[int, Any]:
    return first, task(first)


def open_source(path: str | Path, storage_options: Mapping[str, str] | None = None) -> xr.Dataset:
    """A cube to be rewritten.

    Raises:
        NotACube, CubeError: It cannot be read, or holds no line.
    """
    source = open_cube(path, chunks=None, storage_options=storage_options)
    if not source.sizes["line"]:
        raise CubeError(f"{path} holds no line.")
    return source

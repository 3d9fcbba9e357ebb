"""The rows of the table: who, by which function, and what must be said beside the number."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One system at one of the two works.

    Attributes:
        name: In the table.
        module, function: What does it, a `work.Scan`.
        note: What it does, and what is not comparable.
        stored: Frames go to Zarr.
        on_disk: Not to a file system in memory, as all others do.
    """

    name: str
    module: str
    function: str
    note: str
    stored: bool = False
    on_disk: bool = False

    @property
    def key(self) -> str:
        return f"{self.module}.{self.function}{'.stored' * self.stored}{'.disk' * self.on_disk}"


OURS, OURS_STORED = "ours.scan", "ours.scan.stored"
RUN_ENGINE, RUN_ENGINE_STORED = "run_engine.scan", "run_engine.scan.stored"

ROWS = (
    Row("bare asyncio", "floor", "scan", "two tasks and a queue: no deadlines, records, errors or clean-up"),
    Row("**scanhsi**, stepped", "ours", "scan", "the engine with everything on; lines are discarded"),
    Row(
        "bluesky RunEngine + ophyd-async",
        "run_engine",
        "scan",
        "`bp.scan`, soft-signal devices, no callbacks; each line is an event document, which the others do not make",
    ),
    Row(
        "RunEngine, bare messages",
        "run_engine",
        "scan_by_messages",
        "the nine messages of a line from a bare generator: without what bluesky's plan functions cost, which users do use",
    ),
    Row(
        "ophyd-async, no RunEngine",
        "run_engine",
        "scan_without_engine",
        "the same devices asked directly: what of the row above is not the engine",
    ),
    Row(
        "pymmcore-plus MDA engine",
        "mda_engine",
        "scan",
        "z-stack; the demo camera cannot do nothing: it hands over a frame of 64 x 512, here the same again and again",
    ),
    Row(
        "Micro-Manager core, no engine",
        "mda_engine",
        "scan_without_engine",
        "stage, snap and image asked directly: what of the row above is not the engine",
    ),
    Row(
        "OpenHSI, `flat` scene",
        "openhsi_camera",
        "scan",
        "moves nothing, and has no engine: a `for` loop with a progress bar. Copies a constant frame into memory",
    ),
    Row(
        "OpenHSI, default scene",
        "openhsi_camera",
        "scan_picture",
        "as above; the time is that of the simulated camera, which makes a spectrum for each pixel",
    ),
    Row(
        "bare asyncio",
        "floor",
        "scan",
        "zarr-python, 32 lines a chunk, in a thread; nothing is synced",
        stored=True,
    ),
    Row(
        "**scanhsi**, stepped",
        "ours",
        "scan",
        "uncompressed like the others; but to (band, line, sample), sharded, with 15 records a line, each shard synced",
        stored=True,
    ),
    Row(
        "scanhsi, as it comes, on disk",
        "ours",
        "scan_compressed",
        "lz4, and the real disk: syncing waits for it. The others leave their data in the system's cache, so no ratio is given",
        stored=True,
        on_disk=True,
    ),
    Row(
        "bluesky RunEngine + ophyd-async",
        "run_engine",
        "scan",
        "a `StandardDetector` that writes its file: zarr-python, 32 lines a chunk, in the loop; nothing is synced",
        stored=True,
    ),
    Row(
        "pymmcore-plus MDA engine",
        "mda_engine",
        "scan",
        "its own OME-Zarr sink (ome-writers on TensorStore), a chunk a line, one frame again and again; nothing is synced",
        stored=True,
    ),
    Row(
        "OpenHSI, `flat` scene",
        "openhsi_camera",
        "scan",
        "all in memory, and to Zarr with xarray after the scan (its own `save` writes NetCDF): p50 and p99 see none of that",
        stored=True,
    ),
)

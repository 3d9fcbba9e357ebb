"""``verify --repair``: tidies what a crash left, writes down what was lost when it is told to, and never removes what is good."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.quicklook import QuicklookSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import LineRecords, LineStatus
from scanhsi.cube.repack import repack
from scanhsi.cube.repair import repair_cube
from scanhsi.cube.verify import verify_cube
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError
from support.cubes import feed, frame, write_cube

SPEC = CubeSpec(
    23, 9, 14, "uint16", 12, attributes={"plan": {"mode": "stepped"}}, quicklook=QuicklookSpec(np.full((3, 9), 1 / 9))
)
MISSING = {2: "lost", 9: "late"}


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, SPEC, lines_per_shard=6, missing=MISSING), virtual=True)
    return path


def contents(path: Path) -> dict[str, bytes]:
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def interrupt(cube: Path) -> None:
    """As a kill before the last status leaves it, and one more while the metadata were replaced."""
    (cube / "status/c/3").unlink()
    (cube / ".zarr.json.0123.partial").write_text("{")
    root = json.loads((cube / "zarr.json").read_text())
    started = root["attributes"]["acquisition"]["started"]
    root["attributes"] |= {"complete": False}
    root["attributes"]["acquisition"] = {"lines_planned": SPEC.lines, "started": started, "finished": None}
    (cube / "zarr.json").write_text(json.dumps(root))


def check_lines(path: Path, stored: set[int]) -> None:
    status = read_records(path).status
    pixels = open_cube(path)["cube"].values
    for line, state in enumerate(status.tolist()):
        assert (state == LineStatus.STORED) == (line in stored), line
        expected = frame(SPEC, line) if line in stored else np.zeros_like(pixels[:, line])
        np.testing.assert_array_equal(pixels[:, line], expected)


def test_nothing_to_do(cube: Path) -> None:
    before, steps = contents(cube), list[str]()
    assert repair_cube(cube, mark_unreadable=True, tell=steps.append).intact
    assert steps == []
    assert contents(cube) == before


def test_dry_run_touches_nothing(cube: Path) -> None:
    interrupt(cube)
    (cube / "cube/c/0/1/0").write_bytes(b"torn")
    before, steps = contents(cube), list[str]()
    repair_cube(cube, mark_unreadable=True, dry_run=True, tell=steps.append)
    assert len(steps) > 5
    assert contents(cube) == before


def test_an_interrupted_cube_is_closed_and_can_still_be_resumed(cube: Path) -> None:
    interrupt(cube)
    repair_cube(cube)
    found = verify_cube(cube)
    assert (found.intact, found.untidy, found.leftovers) == (True, False, ())
    check_lines(cube, set(range(18)) - MISSING.keys())
    summary = cube_summary(cube)
    assert (summary.complete, summary.lines_planned, summary.shape[1]) == (False, 23, 18)

    async def resume() -> None:
        writer = CubeWriter.resume(cube, SPEC)
        assert writer.next_line == 18
        records = LineRecords(SPEC.lines)
        await writer.open(records)
        await feed(writer, SPEC, records, range(18, SPEC.lines), {})
        await writer.close()

    clock.run(resume(), virtual=True)
    check_lines(cube, set(range(23)) - MISSING.keys())
    assert verify_cube(cube).intact


DAMAGE: dict[str, Callable[[Path], object]] = {
    "bit": lambda file: file.write_bytes(bytes([file.read_bytes()[0] ^ 1]) + file.read_bytes()[1:]),
    "torn": lambda file: file.write_bytes(file.read_bytes()[:700]),
    "empty": lambda file: file.write_bytes(b""),
    "gone": lambda file: file.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_unreadable_lines_stay_until_told_then_are_missing(cube: Path, damage: str) -> None:
    file = cube / "cube/c/0/1/0"
    DAMAGE[damage](file)
    before = contents(cube)
    repair_cube(cube)
    assert contents(cube) == before, "only --mark-unreadable takes promises back"
    repair_cube(cube, mark_unreadable=True)
    found = verify_cube(cube)
    assert found.intact, found.problems
    check_lines(cube, set(range(23)) - MISSING.keys() - set(range(6, 12)))
    reasons = read_records(cube).missing
    assert "unreadable: cube/c/0/1/0" in reasons[6]
    assert reasons[9] == "late", "the first reason stands"
    assert cube_summary(cube).lines_stored == 16
    if damage != "gone":
        assert (cube / "cube/c/0/1/0.damaged").read_bytes() == before["cube/c/0/1/0"]
        assert [leftover.ours for leftover in found.leftovers] == [False], "what was set aside is kept"


def test_lost_records_cost_no_pixels(cube: Path) -> None:
    (cube / "time/c/1").unlink()
    (cube / "mirror_step/c/1").write_bytes(b"short")
    repair_cube(cube, mark_unreadable=True)
    assert verify_cube(cube).intact
    check_lines(cube, set(range(23)) - MISSING.keys())
    assert np.isnat(open_cube(cube)["time"].values[6:12]).all()


@pytest.mark.parametrize("how", ["gone", "short"])
def test_lines_of_a_lost_status_are_nobodys_to_remove(cube: Path, how: str) -> None:
    file = cube / "status/c/3"
    file.unlink() if how == "gone" else file.write_bytes(b"\x01")
    pixels = (cube / "cube/c/0/3/0").read_bytes()
    repair_cube(cube)
    repair_cube(cube)
    assert (cube / "cube/c/0/3/0").read_bytes() == pixels
    assert not verify_cube(cube).intact
    repair_cube(cube, mark_unreadable=True)
    repair_cube(cube)
    assert verify_cube(cube).intact
    assert read_records(cube).missing[20].startswith("unreadable: status/c/3")
    assert (cube / "cube/c/0/3/0").read_bytes() == pixels


def test_metadata_of_an_array(cube: Path) -> None:
    before = json.loads((cube / "time/zarr.json").read_text())
    (cube / "time/zarr.json").write_text("{")
    (cube / "cube/zarr.json").unlink()
    repair_cube(cube)
    assert verify_cube(cube).intact
    assert json.loads((cube / "time/zarr.json").read_text()) == before
    check_lines(cube, set(range(23)) - MISSING.keys())


def test_an_older_cube_is_mended_too(tmp_path: Path) -> None:
    """Without checksums, one chunk a file, as plain zarr-python writes it."""
    import zarr

    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, SPEC, lines_per_shard=6, missing=MISSING), virtual=True)
    group = zarr.open_group(path, mode="r+", use_consolidated=False)
    pixels = np.asarray(group["cube"][:])  # pyright: ignore
    attributes = dict(group["cube"].attrs)
    shutil.rmtree(path / "cube")
    group.create_array(
        "cube", data=pixels, chunks=(9, 6, 14), dimension_names=("band", "line", "sample"), compressors=None,
        attributes=attributes,
    )  # fmt: skip
    with pytest.warns(match="Consolidated metadata"):
        zarr.consolidate_metadata(path)
    found = verify_cube(path)
    assert found.intact
    assert not found.checksummed
    assert any("no checksums" in note for note in found.notes)
    (path / "cube/c/0/1/0").write_bytes(b"torn")
    assert verify_cube(path).bad_lines == (6, 7, 8, 10, 11)
    repair_cube(path, mark_unreadable=True)
    assert verify_cube(path).intact
    check_lines(path, set(range(23)) - MISSING.keys() - set(range(6, 12)))


def test_repair_tells_what_the_disk_says(cube: Path) -> None:
    interrupt(cube)
    (cube / "cube/zarr.json").unlink()
    (cube / "cube/zarr.json").mkdir()
    with pytest.raises(CubeError, match="cannot repair"):
        repair_cube(cube)


def test_a_repacked_cube_keeps_its_promises(cube: Path) -> None:
    repack(cube, codec="zstd")
    found = verify_cube(cube)
    assert found.intact
    assert (found.lines_stored, found.untidy, found.leftovers) == (21, False, ())


def test_what_a_repack_begun_leaves_is_told(cube: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new cube beside it is verified like any other, and its half is no lie either."""
    from scanhsi.cube.shards import CubeFiles

    write = CubeFiles.write_pixels
    shards: list[int] = []

    def die(self: CubeFiles, *args: Any, **options: Any) -> Any:
        shards.append(1)
        if len(shards) > 2:
            raise CubeError("the disk is gone")
        return write(self, *args, **options)

    monkeypatch.setattr(CubeFiles, "write_pixels", die)
    with pytest.raises(CubeError, match="the disk is gone"):
        repack(cube, codec="zstd", threads=1)
    assert verify_cube(cube).intact
    (half,) = [path for path in cube.parent.iterdir() if path != cube]
    found = verify_cube(half)
    assert not found.bad_lines


def test_a_damaged_frame_of_a_raw_cube_costs_that_line(tmp_path: Path) -> None:
    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", SPEC, lines_per_shard=6, codec="raw")
        await writer.open(records)
        await feed(writer, SPEC, records, range(SPEC.lines), MISSING)
        await writer.close()

    clock.run(main(), virtual=True)
    cube = tmp_path / "cube.zarr"
    assert verify_cube(cube).intact
    DAMAGE["bit"](cube / "cube/c/0/1/0")
    assert verify_cube(cube).bad_lines == (6,)
    repair_cube(cube, mark_unreadable=True)
    assert verify_cube(cube).intact
    check_lines(cube, set(range(23)) - MISSING.keys() - {6})

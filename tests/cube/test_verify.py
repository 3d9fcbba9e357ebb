"""``verify`` believes nothing that it has not read, and finds every kind of damage; what is good it leaves alone."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import LineRecords
from scanhsi.cube.verify import Verification, verify_cube
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError, NotACube
from support.cubes import feed, write_cube

SPEC = CubeSpec(23, 9, 14, "uint16", 12, wavelength_nm=np.linspace(400, 900, 9))
MISSING = {2: "lost", 9: "late"}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("good") / "cube.zarr"
    clock.run(write_cube(path, SPEC, lines_per_shard=6, missing=MISSING), virtual=True)
    return path


@pytest.fixture
def cube(good: Path, tmp_path: Path) -> Path:
    return shutil.copytree(good, tmp_path / "cube.zarr")


def change(file: Path, act: Callable[[bytearray], None]) -> None:
    data = bytearray(file.read_bytes())
    act(data)
    file.write_bytes(data)


def flip(file: Path, at: int) -> None:
    change(file, lambda data: data.__setitem__(at, data[at] ^ 1))


def rewrite(file: Path, act: Callable[[dict[str, object]], None]) -> None:
    value = json.loads(file.read_text())
    act(value)
    file.write_text(json.dumps(value))


def problem(found: Verification) -> tuple[str, str, tuple[int, ...]]:
    (only,) = found.problems
    return only.file, only.reason, only.lines


def test_a_good_cube(good: Path) -> None:
    calls: list[tuple[int, int]] = []
    found = verify_cube(good, progress=lambda done, total: calls.append((done, total)))
    assert found.intact
    assert (found.lines_reached, found.lines_stored, found.lines_missing) == (23, 21, 2)
    assert not found.bad_lines
    assert not found.leftovers
    assert not found.untidy
    assert calls == [(done, len(calls)) for done in range(1, len(calls) + 1)]


def test_every_byte_of_a_shard_counts(cube: Path) -> None:
    """A flipped bit anywhere in a shard is noticed: in the pixels by their checksum, in the index by its own."""
    file = cube / "cube/c/0/1/0"
    whole = file.read_bytes()
    described = [at for at in range(len(whole)) if described_by(cube, at)]
    rng = np.random.default_rng(0)
    for at in sorted({*rng.choice(described, 60).tolist(), described[0], described[-1]}):
        flip(file, at)
        found = verify_cube(cube, threads=1)
        assert set(found.bad_lines) <= {6, 7, 8, 10, 11}, at
        assert found.bad_lines, f"bit flipped at {at} of {len(whole)} went unnoticed"
        file.write_bytes(whole)
    assert verify_cube(cube).intact


def described_by(cube: Path, at: int) -> bool:
    """Whether a byte of the second shard belongs to its index or to an inner chunk (and not to the padding between them)."""
    data = (cube / "cube/c/0/1/0").read_bytes()
    sharding = json.loads((cube / "cube/zarr.json").read_text())["codecs"][0]["configuration"]
    outer = json.loads((cube / "cube/zarr.json").read_text())["chunk_grid"]["configuration"]["chunk_shape"]
    chunks = int(np.prod([-(-a // b) for a, b in zip(outer, sharding["chunk_shape"], strict=True)]))
    size = 16 * chunks + 4
    index = np.frombuffer(data[-size:-4], "<u8").reshape(-1, 2)
    return at >= len(data) - size or any(offset <= at < offset + length for offset, length in index)


@pytest.mark.parametrize("size", [0, 3, 40, -30, -1])
def test_a_torn_shard(cube: Path, size: int) -> None:
    file = cube / "cube/c/0/1/0"
    file.write_bytes(file.read_bytes()[:size])
    name, _, lines = problem(verify_cube(cube))
    assert (name, lines) == ("cube/c/0/1/0", (6, 7, 8, 10, 11))


def test_a_missing_shard_is_no_black_one(cube: Path) -> None:
    (cube / "cube/c/0/3/0").unlink()
    assert problem(verify_cube(cube)) == ("cube/c/0/3/0", "is not there", (18, 19, 20, 21, 22))


def test_an_empty_place_in_the_index_is_no_black_chunk(cube: Path) -> None:
    from scanhsi.cube.described import describe
    from scanhsi.cube.pieces import blank

    array = describe(cube).arrays["cube"]
    blank(array, cube / "cube/c/0/0/0", {0}, axis=1)
    found = verify_cube(cube)
    assert found.bad_lines[0] == 0
    assert all("is not there" in problem.reason for problem in found.problems)


def test_the_disk_does_not_give_it_back(cube: Path) -> None:
    (cube / "cube/c/0/0/0").unlink()
    (cube / "cube/c/0/0/0").mkdir()  # opens, and cannot be read
    name, reason, lines = problem(verify_cube(cube))
    assert (name, lines) == ("cube/c/0/0/0", (0, 1, 3, 4, 5))
    assert "cannot be read: Is a directory" in reason or "less than its index" in reason


@pytest.mark.parametrize("name", ["time", "mirror_step", "stored_ns"])
def test_records(cube: Path, name: str) -> None:
    (cube / name / "c/1").unlink()
    change(cube / name / "c/2", lambda data: data.pop())
    found = verify_cube(cube)
    assert [problem.kind for problem in found.problems] == ["records", "records"]
    assert found.bad_lines == (6, 7, 8, 10, 11, 12, 13, 14, 15, 16, 17)


def test_wavelengths(cube: Path) -> None:
    (cube / "wavelength/c/0").unlink()
    assert problem(verify_cube(cube)) == ("wavelength/c/0", "is not there", ())


@pytest.mark.parametrize("how", ["gone", "short"])
def test_a_status_that_was_lost(cube: Path, how: str) -> None:
    """It says not stored, or cannot be read: both look like an interrupted scan, and are none."""
    file = cube / "status/c/3"
    file.unlink() if how == "gone" else file.write_bytes(b"\x01")
    found = verify_cube(cube)
    assert "nothing vouches for lines 18 to 22" in found.problems[0].reason
    assert found.bad_lines == (18, 19, 20, 21, 22)
    assert found.leftovers
    assert not any(leftover.ours for leftover in found.leftovers), "these pixels may be good"


def test_a_status_that_makes_no_sense(cube: Path) -> None:
    change(cube / "status/c/1", lambda data: data.__setitem__(0, 7))
    change(cube / "status/c/0", lambda data: data.__setitem__(3, 0))
    reasons = [problem.reason for problem in verify_cube(cube).problems]
    assert any("line 6 has status 7" in reason for reason in reasons)
    assert any("line 3 is not stored, and later lines are" in reason for reason in reasons)
    assert any("counted 21 lines stored when it was closed; now there are 19" in reason for reason in reasons)


def test_metadata(cube: Path) -> None:
    (cube / "time/zarr.json").unlink()
    (cube / "frame_id/zarr.json").write_text("{")
    rewrite(cube / "cube/zarr.json", lambda value: value.__setitem__("fill_value", 3))
    found = verify_cube(cube)
    assert {problem.file for problem in found.problems} == {
        f"{name}/zarr.json" for name in ("time", "frame_id", "cube")
    }
    (cube / "zarr.json").write_text("{")
    with pytest.raises(CubeError, match="is damaged"):
        verify_cube(cube)


def test_no_cube(tmp_path: Path) -> None:
    for path in (tmp_path / "no", tmp_path):
        with pytest.raises(NotACube):
            verify_cube(path)
    with pytest.raises(CubeError, match="is in an object store"):
        verify_cube("s3://bucket/cube.zarr")


LEFT = (
    ".zarr.json.0123456789abcdef0123456789abcdef.partial",
    "cube/c/0/1/.0.aa.partial",
    "cube/c/0/1/0.8d9f7a.partial",
    "cube/c/0/1/0.__lock",
    "status/c/1.__tmp",
    "status/c/1#1",
    "status/c/77",
    "cube/c/1/0/0",
)


def test_leftovers_do_no_harm(cube: Path) -> None:
    for name in LEFT:
        (cube / name).parent.mkdir(parents=True, exist_ok=True)
        (cube / name).write_text("x")
    (cube / "notes.txt").write_text("precious")
    beside = cube.with_name(f".{cube.name}.{'0' * 32}.partial")
    beside.mkdir()
    cube.with_name(f".other{cube.name}.{'0' * 32}.partial").mkdir()
    found = verify_cube(cube)
    assert found.intact
    ours = {leftover.path for leftover in found.leftovers if leftover.ours}
    assert ours == {beside, *(cube / name for name in LEFT)}
    assert [leftover.path for leftover in found.leftovers if not leftover.ours] == [cube / "notes.txt"]


def test_an_interrupted_scan_is_no_problem(tmp_path: Path, good: Path) -> None:
    """The last shard was written and nothing vouches for it yet: killed at that moment, the cube is good as far as it goes."""
    cube = shutil.copytree(good, tmp_path / "cube.zarr")
    (cube / "status/c/3").unlink()
    open_ended = {"finished": None, "lines_planned": 23}
    rewrite(cube / "zarr.json", lambda root: root["attributes"].update(complete=False, acquisition=open_ended))  # pyright: ignore
    found = verify_cube(cube)
    assert found.intact
    assert found.untidy
    assert (found.lines_reached, found.lines_stored) == (18, 16)
    assert {leftover.path.relative_to(cube).parts[0] for leftover in found.leftovers} >= {"cube", "time", "stored_ns"}
    assert all(leftover.ours for leftover in found.leftovers)


def test_memory_does_not_grow_with_the_cube(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    spec = CubeSpec(64, 64, 500, "uint16", 16)
    clock.run(write_cube(path, spec, lines_per_shard=32), virtual=True)
    verify_cube(path)  # imports
    tracemalloc.start()
    assert verify_cube(path, threads=2).intact
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 0.7 * spec.lines * spec.line_bytes


def test_a_cube_that_is_being_written_is_checked_as_far_as_it_is(tmp_path: Path) -> None:
    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", SPEC, lines_per_shard=6)
        await writer.open(records)
        for start, stop in ((0, 8), (8, 13), (13, 23)):
            await feed(writer, SPEC, records, range(start, stop), {})
            await writer.flush()
            found = verify_cube(tmp_path / "cube.zarr")
            assert (found.intact, found.lines_stored, found.untidy) == (True, stop, True)
        await writer.close()

    clock.run(main(), virtual=True)
    assert not verify_cube(tmp_path / "cube.zarr").untidy

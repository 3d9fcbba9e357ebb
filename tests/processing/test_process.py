from pathlib import Path

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.calibration.reference import average
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CalibrationError, CubeExists
from scanhsi.processing import BinBands, MaskSaturated, Pipeline, Reflectance, Signal, SubtractDark, process
from support.cubes import feed, whole

PLAN = {"exposure_s": 0.02, "gain_db": 0.0, "pixel_format": "Mono12"}


def spec(lines: int, **plan: object) -> CubeSpec:
    return CubeSpec(
        lines=lines,
        bands=23,
        samples=40,
        dtype=np.uint16,
        significant_bits=12,
        attributes={"run": "r", "plan": {**PLAN, **plan}, "simulated": True},
        wavelength_nm=np.linspace(400, 900, 23),
    )


def write(
    path: Path, what: CubeSpec, pixels: np.ndarray | None = None, *, missing: dict[int, str] | None = None
) -> Path:
    async def main() -> None:
        records = LineRecords(what.lines)
        writer = CubeWriter(path, what, lines_per_shard=8)
        await writer.open(records)
        if pixels is None:
            await feed(writer, what, records, range(what.lines), missing or {})
        else:
            for line in range(what.lines):
                buffer = writer.buffer(line)
                assert buffer is not None
                buffer[:] = pixels[:, line]
                await writer.append(line)
        await writer.flush()
        await writer.close()

    clock.run(main(), virtual=True)
    return path


@pytest.fixture
def cubes(tmp_path):
    rng = np.random.default_rng(1)
    dark = np.full((23, 8, 40), 60) + rng.integers(0, 9, (23, 8, 40))
    white = np.full((23, 8, 40), 3000) + rng.integers(0, 99, (23, 8, 40))
    write(tmp_path / "dark.zarr", spec(8), dark)
    write(tmp_path / "white.zarr", spec(8), white)
    write(tmp_path / "hand.zarr", spec(45), missing={20: "lost"})
    return tmp_path


def steps(folder: Path):
    dark, white = average(folder / "dark.zarr"), average(folder / "white.zarr")
    return [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, tile=0.99), BinBands(5)]


def expected(folder: Path) -> np.ndarray:
    raw = whole(spec(45), 45).astype(float)
    raw[raw >= 4095] = np.nan
    dark = open_cube(folder / "dark.zarr")["cube"].values.mean(axis=1)[:, None]
    white = open_cube(folder / "white.zarr")["cube"].values.mean(axis=1)[:, None]
    reflectance = 0.99 * (raw - dark) / (white - dark)
    return np.stack([reflectance[first : first + 5].mean(axis=0) for first in range(0, 23, 5)])


def check(folder: Path, path: Path) -> None:
    dataset = open_cube(path)
    good = dataset["status"].values == 1
    assert np.flatnonzero(~good).tolist() == [20]
    np.testing.assert_allclose(dataset["cube"].values[:, good], expected(folder)[:, good], rtol=1e-4, atol=1e-5)
    assert dataset["cube"].dtype == np.float32
    assert dataset["cube"].attrs["long_name"] == "reflectance"
    assert dataset.sel(wavelength=445, method="nearest").sizes["line"] == 45
    before, after = read_records(folder / "hand.zarr"), read_records(path)
    np.testing.assert_array_equal(after.stamps["exposure_start"], before.stamps["exposure_start"])
    assert after.missing == {20: "lost"}
    summary = cube_summary(path)
    assert summary.complete
    assert summary.simulated
    assert [step["step"] for step in summary.attributes["processing"]] == [
        "read",
        "mask saturated",
        "subtract dark",
        "reflectance",
        "bin bands",
    ]


def test_threads_make_the_reflectance_that_arithmetic_makes(cubes):
    told = []
    process(
        cubes / "hand.zarr", cubes / "out.zarr", steps(cubes), progress=lambda done, total: told.append(done / total)
    )
    check(cubes, cubes / "out.zarr")
    assert told[-1] == 1


def test_two_workers_of_a_cluster_make_the_same_bit_for_bit(cubes):
    from distributed import Client, LocalCluster

    process(cubes / "hand.zarr", cubes / "threads.zarr", steps(cubes))
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        Client(cluster) as client,
    ):
        process(cubes / "hand.zarr", cubes / "cluster.zarr", steps(cubes), client=client)
    check(cubes, cubes / "cluster.zarr")
    np.testing.assert_array_equal(open_cube(cubes / "threads.zarr")["cube"], open_cube(cubes / "cluster.zarr")["cube"])


def test_what_was_interrupted_goes_on(cubes):
    class Stop(Exception):
        pass

    def stop_after_two(done, total):
        if done >= total / 3:
            raise Stop

    with pytest.raises(Stop):
        process(cubes / "hand.zarr", cubes / "out.zarr", steps(cubes), threads=1, progress=stop_after_two)
    half = cube_summary(cubes / "out.zarr")
    assert not half.complete
    with pytest.raises(CubeExists):
        process(cubes / "hand.zarr", cubes / "out.zarr", steps(cubes))
    with pytest.raises(CubeExists, match="made in another way"):
        process(cubes / "hand.zarr", cubes / "out.zarr", steps(cubes)[:2], resume=True)
    told = []
    process(
        cubes / "hand.zarr",
        cubes / "out.zarr",
        steps(cubes),
        resume=True,
        progress=lambda done, total: told.append(done / total),
    )
    assert told[0] > 1 / 3
    check(cubes, cubes / "out.zarr")


def test_nothing_is_written_where_a_reference_does_not_fit(cubes):
    write(cubes / "other.zarr", spec(8, exposure_s=0.1))
    with pytest.raises(CalibrationError, match="exposure 100 ms instead of 20 ms"):
        process(cubes / "hand.zarr", cubes / "out.zarr", [SubtractDark(average(cubes / "other.zarr"))])
    assert not (cubes / "out.zarr").exists()


def test_lines_as_they_arrive_give_what_the_cube_gives(cubes):
    process(cubes / "hand.zarr", cubes / "out.zarr", steps(cubes))
    raw = open_cube(cubes / "hand.zarr")
    live = Pipeline(Signal.of(raw), steps(cubes))
    stored = open_cube(cubes / "out.zarr")["cube"].values
    for line in (0, 7, 8, 44):
        np.testing.assert_array_equal(live(raw["cube"].isel(line=line).values), stored[:, line])


def test_colours_of_reflectance_need_no_guess(cubes):
    from scanhsi.calibration.view import view

    process(cubes / "hand.zarr", cubes / "out.zarr", steps(cubes))
    look = view(cubes / "out.zarr")
    assert look.quantity == "reflectance"
    assert "of the reflectance" in look.colour_note
    assert view(cubes / "hand.zarr").quantity == "counts"

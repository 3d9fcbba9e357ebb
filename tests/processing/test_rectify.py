import math
from dataclasses import replace

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.result import Provenance
from scanhsi.cube.exchange import export_cube
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CalibrationError, CubeExists
from scanhsi.processing import BinBands, MaskSaturated, process, rectified, rectify

LINES, BANDS, SAMPLES = 121, 3, 90
STEPS = 8 * (np.arange(LINES) - 60)  # to 18 degrees from the normal
MODEL = Geometry(348.73, 4.0, 2 * math.pi / 19_200, 1.5, 44.5, Provenance(("grid.zarr",)))


def scene(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What lies at a place: smooth, up to 3000 counts."""
    return 1500 + 800 * np.sin(x / 9) * np.cos(y / 13) + 500 * np.cos(y / 21)


def write(path, model: Geometry, steps=STEPS, missing=(), saturated=()):
    spec = CubeSpec(
        lines=len(steps),
        bands=BANDS,
        samples=SAMPLES,
        dtype=np.uint16,
        significant_bits=12,
        attributes={"plan": {}, "simulated": True},
        wavelength_nm=np.array([450.0, 550, 650]),
    )

    async def main() -> None:
        records = LineRecords(spec.lines)
        writer = CubeWriter(path, spec, lines_per_shard=16)
        await writer.open(records)
        for line, step in enumerate(steps):
            if line in missing:
                records.mark_missing(line, "lost")
            else:
                x = model.x_mm(np.arange(SAMPLES), step)
                values = scene(x, model.y_mm(step)) * np.array([1.0, 0.5, 0.25])[:, None]
                buffer = writer.buffer(line)
                buffer[:] = np.rint(values)
                for band, sample in [(b, s) for at, b, s in saturated if at == line]:
                    buffer[band, sample] = 4095
                records.mirror_step[line] = step
                records.stamps["commanded"][line] = 1000 + line
            await writer.append(line)
        await writer.flush()
        await writer.close()

    clock.run(main(), virtual=True)
    return path


@pytest.mark.parametrize(
    "model",
    [
        MODEL,
        replace(MODEL, tilt_rad=0.08),
        replace(MODEL, step_rad=-MODEL.step_rad),
        replace(MODEL, sample_pitch_mm=-1.5),
    ],
    ids=["plain", "tilted", "other direction", "mirrored"],
)
def test_places_are_where_they_say(tmp_path, model: Geometry):
    flat = rectified(open_cube(write(tmp_path / "raw.zarr", model), chunks=None), model)
    x, y = flat["x"].values, flat["y"].values
    for axis in (x, y):
        np.testing.assert_allclose(np.diff(axis), np.diff(axis)[0])
    truth = scene(x[None, :], y[:, None])
    values = flat["cube"].values
    known = np.isfinite(values[0])
    assert known.mean() > 0.9
    assert (
        np.abs(values[0] - truth)[known].max() < 14
    )  # of 3000: cells of 1.8 and 1.5 mm take means, and counts are whole
    np.testing.assert_allclose(values[1][known], values[0][known] / 2, atol=1)


def test_a_coarse_grid_takes_means_and_the_sum_stays(tmp_path):
    source = open_cube(write(tmp_path / "raw.zarr", MODEL), chunks=None)
    fine, coarse = rectified(source, MODEL, pitch_mm=0.5), rectified(source, MODEL, pitch_mm=6.0)
    assert np.diff(coarse["x"])[0] == pytest.approx(6.0)
    assert np.diff(coarse["y"])[0] == pytest.approx(-6.0)  # as scanned
    small = fine["cube"].values[0]
    for row in (4, 10, 20):
        for column in (4, 9):
            y, x = float(coarse["y"][row]), float(coarse["x"][column])
            cell = small[np.abs(fine["y"].values - y) < 3][:, np.abs(fine["x"].values - x) < 3]
            assert float(coarse["cube"][0, row, column]) == pytest.approx(float(cell.mean()), rel=0.01)


def test_a_written_cube_is_the_lazy_one_and_has_its_coordinates(tmp_path):
    lazy = rectified(open_cube(write(tmp_path / "raw.zarr", MODEL), chunks=None), MODEL, pitch_mm=2.0)
    grid = rectify(tmp_path / "raw.zarr", tmp_path / "flat.zarr", MODEL, pitch_mm=2.0)
    flat = open_cube(tmp_path / "flat.zarr")
    np.testing.assert_array_equal(flat["cube"].values, lazy["cube"].values)
    np.testing.assert_array_equal(flat["cube"].values[1, 5], lazy["cube"][1, 5].values)
    np.testing.assert_array_equal(flat["x"].values, grid.x_mm)
    np.testing.assert_array_equal(flat["y"].values, grid.y_mm)
    assert (flat["x"].attrs["units"], flat["y"].dims) == ("mm", ("line",))
    assert flat["wavelength"].values.tolist() == [450, 550, 650]
    assert flat.attrs["processing"][-1]["distance_mm"] == 348.73
    assert flat.attrs["simulated"] is True
    scale = flat.attrs["ome"]["multiscales"][0]["datasets"][0]["coordinateTransformations"][0]["scale"]
    assert scale == pytest.approx([1, 2, 2])
    assert flat.sel(x=0, y=0, method="nearest")["mirror_step"] == pytest.approx(MODEL.normal_step, abs=8)
    assert flat["commanded_ns"].values[0] in (1000, 1001)
    process(tmp_path / "flat.zarr", tmp_path / "binned.zarr", [BinBands(3)])
    np.testing.assert_array_equal(open_cube(tmp_path / "binned.zarr")["x"].values, grid.x_mm)


def test_missing_lines_and_saturated_pixels_stay_unknown(tmp_path):
    path = write(tmp_path / "raw.zarr", MODEL, missing=(40,), saturated=[(80, 1, 30)])
    flat = rectified(open_cube(path, chunks=None), MODEL)
    middle = flat["cube"].values[:, :, 20:-20]
    hole = (MODEL.y_mm(STEPS[39]), MODEL.y_mm(STEPS[41]))
    lost = np.isnan(middle[0]).all(axis=1)
    inside = (flat["y"].values < hole[0] - 0.95) & (flat["y"].values > hole[1] + 0.95)
    assert inside.any()
    assert lost[inside].all()
    assert 2 <= lost.sum() <= 4
    spots = np.argwhere(np.isnan(flat["cube"].values[1]) & ~np.isnan(flat["cube"].values[0]))
    assert 4 <= len(spots) <= 9
    y, x = flat["y"].values[spots[:, 0]], flat["x"].values[spots[:, 1]]
    assert np.abs(y - MODEL.y_mm(STEPS[80])).max() < 3
    assert np.abs(x - MODEL.x_mm(30, STEPS[80])).max() < 3


def test_bands_and_windows_are_read_alone(tmp_path):
    flat = rectified(open_cube(write(tmp_path / "raw.zarr", MODEL), chunks=None), MODEL)
    whole = flat["cube"].values
    np.testing.assert_array_equal(flat["cube"].isel(band=2).values, whole[2])
    np.testing.assert_array_equal(
        flat["cube"].isel(line=slice(10, 30, 3), sample=slice(5, 9)).values, whole[:, 10:30:3, 5:9]
    )
    np.testing.assert_array_equal(flat["cube"].sel(wavelength=550).isel(line=7).values, whole[1, 7])


def test_what_makes_no_grid_is_refused(tmp_path):
    dataset = open_cube(write(tmp_path / "raw.zarr", MODEL), chunks=None)
    with pytest.raises(CalibrationError, match="pitch of -1"):
        rectified(dataset, MODEL, pitch_mm=-1.0)
    with pytest.raises(CalibrationError, match="grid of"):
        rectified(dataset, MODEL, pitch_mm=1e-4)
    with pytest.raises(CalibrationError, match="degrees from the normal"):
        rectify(tmp_path / "raw.zarr", tmp_path / "no.zarr", replace(MODEL, normal_step=5000.0))
    assert not (tmp_path / "no.zarr").exists()
    still = open_cube(write(tmp_path / "still.zarr", MODEL, steps=np.full(6, 3)), chunks=None)
    with pytest.raises(CalibrationError, match="1 steps of the mirror"):
        rectified(still, MODEL)
    with pytest.raises(CalibrationError, match="where the mirror was"):
        rectified(dataset.drop_vars("mirror_step"), MODEL)


def test_a_masked_cube_is_rectified_alike(tmp_path):
    write(tmp_path / "raw.zarr", MODEL)
    process(tmp_path / "raw.zarr", tmp_path / "masked.zarr", [MaskSaturated()])
    one, other = (rectified(open_cube(tmp_path / name, chunks=None), MODEL) for name in ("raw.zarr", "masked.zarr"))
    np.testing.assert_array_equal(one["cube"].values, other["cube"].values)


def test_a_geotiff_is_where_the_grid_is(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    write(tmp_path / "raw.zarr", MODEL)
    grid = rectify(tmp_path / "raw.zarr", tmp_path / "flat.zarr", MODEL, pitch_mm=2.0)
    export_cube(tmp_path / "flat.zarr", tmp_path / "flat.tif")
    with rasterio.open(tmp_path / "flat.tif") as raster:
        x, y = raster.xy(5, 7)  # middle of a pixel, in the file's units: metres or mm as the exporter has it
        assert x / y == pytest.approx(grid.x_mm[7] / grid.y_mm[5], rel=1e-6)
        assert raster.shape == (len(grid.y_mm), len(grid.x_mm))


def test_what_was_interrupted_goes_on_and_is_not_complete_before(tmp_path):
    write(tmp_path / "raw.zarr", MODEL)
    with pytest.raises(ZeroDivisionError):
        rectify(tmp_path / "raw.zarr", tmp_path / "out.zarr", MODEL, threads=1, progress=lambda *_: 1 // 0)
    assert open_cube(tmp_path / "out.zarr").attrs["complete"] is False
    with pytest.raises(CubeExists):
        rectify(tmp_path / "raw.zarr", tmp_path / "out.zarr", MODEL)
    with pytest.raises(CubeExists, match="another way"):
        rectify(tmp_path / "raw.zarr", tmp_path / "out.zarr", MODEL, pitch_mm=0.3, resume=True)
    rectify(tmp_path / "raw.zarr", tmp_path / "out.zarr", MODEL, resume=True)
    rectify(tmp_path / "raw.zarr", tmp_path / "whole.zarr", MODEL)
    out, whole = open_cube(tmp_path / "out.zarr"), open_cube(tmp_path / "whole.zarr")
    np.testing.assert_array_equal(out["cube"].values, whole["cube"].values)
    assert out.attrs["complete"] is True

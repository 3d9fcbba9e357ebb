"""What a stored result is refused for, and what it is told to do about it."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanhsi.calibration.applies import Limits, check_applies, check_files
from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.result import Provenance, save
from scanhsi.devices.errors import CalibrationError

ROI = {"samples": 20, "bands": 10, "sample_offset": 4, "band_offset": 0}
TAKEN = "2026-11-22T10:00:00+00:00"
CUBE = Conditions(0.02, 3.0, "Mono12", ROI, {"bands": 1, "samples": 1}, 25.0, "2026-11-22T15:00:00+00:00")
MADE = Provenance(("dark.zarr",), replace(CUBE, exposure_s=None), True, taken=TAKEN, temperature_c=25.0)


def dark(provenance: Provenance = MADE) -> DarkModel:
    one = np.ones((10, 20))
    return DarkModel(one, one, one, one, one, one, one > 1, one > 1, 0.01, 2.0, 8, provenance)


def plane(provenance: Provenance = MADE) -> Geometry:
    return Geometry(348.73, 0.0, 3e-4, 0.1, 10.0, provenance)


@pytest.mark.parametrize(
    ("change", "limits", "why", "way_out"),
    [
        ({"gain_db": 6.0}, Limits(), r"gain 3 dB instead of 6 dB", "take a new dark model like this"),
        ({"pixel_format": "Mono8"}, Limits(), "pixel format Mono12 instead of Mono8", "take a new"),
        ({"roi": {**ROI, "sample_offset": 5}}, Limits(), "region .* instead of", "take a new"),
        ({"binning": {"bands": 5, "samples": 1}}, Limits(), "binning .* instead of", "take a new"),
        ({}, Limits(timedelta(hours=2)), "5 h older than what it is used on, 2 h at most", "--max-age '1 d'"),
        ({"taken": "2026-10-01T00:00:00+00:00"}, Limits(), "52.42 d younger .*, 30 d at most", "--max-age '53 d'"),
        ({"temperature_c": 40.2}, Limits(), "was at 25.0 degC and is at 40.2 degC", "--max-drift 16"),
    ],
)
def test_it_is_refused_with_the_reason_and_the_way_out(
    change: dict[str, Any], limits: Limits, why: str, way_out: str
) -> None:
    with pytest.raises(CalibrationError, match=f"the dark model dark.nc does not apply: .*{why}") as refused:
        check_applies(dark(), replace(CUBE, **change), limits, source="dark.nc")
    assert way_out in str(refused.value.hint)


@pytest.mark.parametrize(
    ("change", "limits"),
    [
        ({}, Limits()),
        ({"exposure_s": 1.0}, Limits()),  # the model is there for that
        ({"pixel_format": "Mono12Packed"}, Limits()),  # the same counts, packed otherwise
        ({"gain_db": None, "roi": None, "binning": None, "temperature_c": None}, Limits()),  # not known
        ({"taken": "2027-12-24T00:00:00+00:00"}, Limits(timedelta.max)),
        ({"temperature_c": 40.2}, Limits(max_drift_c=16)),
    ],
)
def test_what_does_not_matter_is_not_refused(change: dict[str, Any], limits: Limits) -> None:
    check_applies(dark(), replace(CUBE, **change), limits)


def test_all_files_of_a_program_are_looked_at_and_what_is_no_result_is_passed_over(tmp_path: Path) -> None:
    save(dark(), tmp_path / "dark.nc")
    cube = {"plan": {"exposure_s": 0.02, "gain_db": 3.0, "pixel_format": "Mono12"}, "instrument": {"roi": ROI}}
    paths = [None, tmp_path / "dark.zarr", "s3://bucket/white.zarr", tmp_path / "dark.nc"]
    check_files(paths, {**cube, "acquisition": {"finished": TAKEN}})
    with pytest.raises(CalibrationError, match=r"dark\.nc does not apply: gain 3 dB instead of 0 dB"):
        check_files(paths, {**cube, "plan": {"gain_db": 0.0}})


def test_places_do_not_depend_on_gain_and_distances_not_on_the_region() -> None:
    check_applies(plane(), replace(CUBE, gain_db=9.0, temperature_c=60.0))
    elsewhere = replace(CUBE, roi={**ROI, "samples": 10})
    check_applies(plane(), elsewhere, region=False)
    with pytest.raises(CalibrationError, match="the geometry does not apply: region"):
        check_applies(plane(), elsewhere)


def test_conditions_of_a_cube_that_names_no_region_are_those_of_the_whole_sensor() -> None:
    attributes = {
        "plan": {"exposure_s": 0.1, "gain_db": 0.0, "pixel_format": "Mono12"},
        "instrument": {"roi": None},
        "devices": {"camera": {"bands": 10, "samples": 20}},
        "sensor_temperature_c": 31.5,
        "acquisition": {"started": TAKEN},
    }
    found = Conditions.of(attributes)
    assert found.roi == {"samples": 20, "bands": 10, "sample_offset": 0, "band_offset": 0}
    assert found.binning == {"bands": 1, "samples": 1}
    assert (found.temperature_c, found.taken) == (31.5, TAKEN)
    imported = Conditions.of({"imported_from": {"header": {"temperature_degC": [20.0, 22.0]}}})
    assert imported == Conditions(temperature_c=21.0)

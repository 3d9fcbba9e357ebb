"""Instrument files: read whole, and all that is wrong said at once."""

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from scanhsi.devices.errors import ConfigError, DeviceUnavailable
from scanhsi.instrument import Geometry, InstrumentConfig, Spectral, load_instrument, shipped, template
from support.spare_drivers import Options

GOOD = """
[camera]
driver = "spare"
address = "there"
settle = "5 ms"
[actuator]
driver = "spare"
[geometry]
distance = "348.73 mm"
normal_step = 1200
[scan]
exposure = "100 ms"
lines = 300
mode = "stepped"
pixel_format = "Mono8"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "lab.toml"
    path.write_text(GOOD)
    return path


def problems(path: Path, text: str) -> ConfigError:
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_instrument(path)
    return caught.value


@pytest.mark.usefixtures("spares")
class TestReading:
    def test_a_good_file(self, file: Path) -> None:
        config = load_instrument(file)
        assert config.name == "lab"
        assert config.camera.driver == "spare"
        assert isinstance(config.camera.options, Options)
        assert config.camera.options.settle_s == 0.005
        assert config.geometry.distance_m == 0.34873
        assert config.geometry.steps_per_revolution == 19_200
        assert config.scan.exposure_s == 0.1
        assert config.storage.codec == "lz4"
        assert config.virtual_time

    def test_overrides_lie_over_the_file(self, file: Path) -> None:
        config = load_instrument(str(file), {"geometry.distance": "0.3 m", "storage.codec": "zstd", "camera.seed": 7})
        assert config.geometry.distance_m == 0.3
        assert config.storage.codec == "zstd"
        assert config.camera.options.model_dump()["seed"] == 7

    def test_an_override_is_checked_like_the_file(self, file: Path) -> None:
        with pytest.raises(ConfigError, match=r"storage\.kodec = 1: there is no such key; did you mean codec\?"):
            load_instrument(file, {"storage.kodec": 1})
        with pytest.raises(ConfigError, match=r"cannot set camera\.driver\.x: camera\.driver is a value, not a table"):
            load_instrument(file, {"camera.driver.x": 1})

    def test_what_is_dumped_as_json_is_the_same_instrument(self, file: Path) -> None:
        config = load_instrument(file)
        assert InstrumentConfig.model_validate_json(config.model_dump_json()) == config

    def test_seed(self, file: Path) -> None:
        config = load_instrument(file).with_seed(42)
        assert config.camera.options.model_dump()["seed"] == 42
        assert config.actuator.options.model_dump()["seed"] == 42
        assert config.camera.options.model_dump()["address"] == "there"

    def test_seed_is_refused_where_it_would_be_ignored(self, file: Path) -> None:
        file.write_text(
            GOOD.replace('driver = "spare"\naddress', 'driver = "wired"\naddress').replace('settle = "5 ms"', "")
        )
        config = load_instrument(file)
        assert not config.virtual_time
        with pytest.raises(ConfigError, match=r"camera\.driver = 'wired' draws nothing at random"):
            config.with_seed(1)

    def test_frozen(self, file: Path) -> None:
        with pytest.raises(ValidationError, match="frozen"):
            load_instrument(file).name = "other"  # type: ignore[misc] that is what is tested


@pytest.mark.usefixtures("spares")
class TestProblems:
    def test_all_at_once(self, file: Path) -> None:
        error = problems(
            file,
            """
            nmae = "x"
            [camera]
            driver = "spare"
            adress = "x"
            settle = 5
            [actuator]
            driver = "sparr"
            [geometry]
            distance = 348.73
            steps_per_revolution = 0
            scan_direction = 2
            [storage]
            codec = "gzip"
            [limits]
            exposure = [10, "2 s"]
            """,
        )
        assert f"instrument file {file} has 10 problems:" in str(error)
        assert "scanhsi schema" in str(error)
        expected = [
            'nmae = "x": there is no such key; did you mean name?',
            'camera.adress = "x": there is no such key; did you mean address?',
            "camera.settle = 5: has no unit; write a number with one of the units",
            "actuator.driver = \"sparr\": there is no actuator driver 'sparr'; installed are: spare.",
            "geometry.distance = 348.73: has no unit;",
            "geometry.steps_per_revolution = 0: input should be greater than 0",
            "geometry.normal_step is missing (step at which the optical axis meets",
            "geometry.scan_direction = 2: input should be 1 or -1",
            "storage.codec = \"gzip\": input should be 'lz4', 'zstd', 'none' or 'raw'",
            "limits.exposure.0 = 10: has no unit;",
        ]
        for start in expected:
            assert sum(problem.startswith(start) for problem in error.problems) == 1, (start, error.problems)
        assert len(error.problems) == len(expected)

    @pytest.mark.parametrize(
        ("text", "fragment"),
        [
            ("[camera\n", "is not valid TOML: Expected ']' at the end of a table declaration (at line 1, column 8)"),
            ("a = 1\na = 2\n", "(at line 2, column 6)"),
            ("", "camera is missing"),
            ('camera = "spare"', 'camera = "spare": input should be a valid dictionary'),
            ("[camera]\n", 'camera.driver = null: write driver = "..." with the name of a camera driver'),
            ("[limits]\ngain = ['3 dB', '0 dB']\n", "the smallest value comes first"),
            ("[roi]\nsamples = 0\nbands = 10\n", "roi.samples = 0: input should be greater than or equal to 1"),
            ('[scan]\nexposure = "0 ms"\n', 'scan.exposure = "0 ms": input should be greater than 0'),
            ('[scan]\npixel_format = "RGB8"\n', "scan.pixel_format = \"RGB8\": input should be 'Mono8', 'Mono12'"),
            ("[spectral]\nwavelength_nm = [1]\n", "spectral.wavelength_nm = [1]: tuple should have at least 2 items"),
        ],
    )
    def test_wrong_files(self, file: Path, text: str, fragment: str) -> None:
        error = problems(file, text)
        assert fragment in str(error)
        assert str(file) in str(error)

    def test_not_text(self, file: Path) -> None:
        file.write_bytes(b"name = '\xff'")
        with pytest.raises(ConfigError, match=r"lab\.toml is not UTF-8 text \(byte 8\)"):
            load_instrument(file)

    def test_no_such_file(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match=r"missing\.toml cannot be read: No such file or directory.*sensors2019"):
            load_instrument(tmp_path / "missing.toml")
        with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
            load_instrument(tmp_path)

    def test_no_such_name(self) -> None:
        with pytest.raises(
            ConfigError, match=r"no instrument 'sensors2018'; did you mean sensors2019\? Try: .*sensors2019, twin"
        ):
            load_instrument("sensors2018")

    def test_a_driver_that_cannot_be_loaded(self, file: Path) -> None:
        file.write_text(GOOD.replace('driver = "spare"\naddress', 'driver = "broken"\naddress'))
        with pytest.raises(
            DeviceUnavailable, match=r"driver 'broken' of unknown cannot be loaded: ModuleNotFoundError"
        ):
            load_instrument(file)

    def test_long_values_are_shortened(self, file: Path) -> None:
        error = problems(file, f'{GOOD}extra = "{"x" * 500}"')
        assert len(error.problems[0]) < 300


def test_shipped_instruments_are_valid() -> None:
    assert shipped() == ["characterise", "sensors2019", "twin"]
    for name in shipped():
        assert load_instrument(name).name == name


def test_the_template_is_valid(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(template())
    assert load_instrument(path).camera.driver == "aravis"


def geometry(**changes: Any) -> Geometry:
    return Geometry.model_validate({"distance": "348.73 mm", "normal_step": 1200, **changes})


def test_mirror_angle() -> None:
    assert geometry().angle_rad(1200) == 0
    assert geometry().step_angle_rad == pytest.approx(0.32725e-3, rel=1e-4)  # H4 of the paper
    assert geometry().angle_rad(2400) == pytest.approx(math.pi / 8)  # mirror range pi/8 = exactly 1200 steps
    assert geometry(scan_direction=-1).angle_rad(2400) == pytest.approx(-math.pi / 8)
    pitch_m = 2 * geometry().step_angle_rad * geometry().distance_m
    assert pitch_m == pytest.approx(0.2282e-3, rel=1e-3)  # Eq. 10: centre pitch at r = 348.73 mm


def test_wavelengths() -> None:
    spectral = Spectral(wavelength_nm=(370.79, 2.68, -1e-4), bands_per_channel=5)
    wavelengths = spectral.wavelengths_nm(1088)
    assert wavelengths[0] == 370.79
    assert wavelengths[217 * 5] == pytest.approx(947.64, abs=0.01)  # erratum 13
    assert spectral.wavelengths_nm(2, first=5)[0] == pytest.approx(373.4699)

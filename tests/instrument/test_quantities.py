"""Quantities: a unit stands in the value or in the name, and what is written comes back exactly."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError

from scanhsi.instrument.quantities import Bytes, Decibels, Metres, Seconds, Steps, Written, format_quantity


class Sample(Written):
    exposure_s: Seconds = Field(default=1.0, alias="exposure", gt=0)
    timeout_s: Seconds | None = Field(default=None, alias="timeout")
    distance_m: Metres = Field(default=1.0, alias="distance")
    gain_db: Decibels = Field(default=0.0, alias="gain")
    buffer_bytes: Bytes = Field(default=1, alias="buffer")
    start: Steps = 0


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("100 ms", 0.1),
        ("20ms", 0.02),
        ("1.5 s", 1.5),
        ("350 us", 350e-6),
        ("350 µs", 350e-6),  # micro sign
        ("350 μs", 350e-6),  # Greek mu
        (" 1e3 ns ", 1e-6),
        (".5 s", 0.5),
        ("2 min", 120.0),
    ],
)
def test_times(text: str, seconds: float) -> None:
    assert Sample.model_validate({"exposure": text}).exposure_s == seconds
    assert Sample.model_validate({"timeout": text}).timeout_s == seconds


def test_other_kinds() -> None:
    sample = Sample.model_validate(
        {"distance": "348.73 mm", "gain": "3 dB", "buffer": "8 MiB", "start": "-12 steps"},
    )
    assert (sample.distance_m, sample.gain_db, sample.buffer_bytes, sample.start) == (0.34873, 3.0, 8 * 2**20, -12)
    assert Sample.model_validate({"start": -3}).start == -3
    assert Sample.model_validate({"start": "-3"}).start == -3


def test_a_name_with_a_unit_takes_a_bare_number() -> None:
    sample = Sample.model_validate({"exposure_s": 0.02, "gain_db": 3})
    assert (sample.exposure_s, sample.gain_db) == (0.02, 3.0)
    assert Sample.model_validate(sample.model_dump()) == sample


@pytest.mark.parametrize(
    ("data", "key", "fragment"),
    [
        ({"exposure": 100}, "exposure", 'has no unit; write a number with one of the units ns, us, µs, ms, s, min, for'),
        ({"exposure": "100"}, "exposure", "has no unit"),
        ({"exposure": True}, "exposure", "has no unit"),
        ({"exposure_s": True}, "exposure_s", "is not a quantity"),
        ({"timeout": 1.5}, "timeout", "has no unit"),
        ({"exposure": "1 Ms"}, "exposure", "has the unit 'Ms'"),
        ({"exposure": "fast"}, "exposure", "is not a number with a unit"),
        ({"exposure": "1 s 2"}, "exposure", "is not a number with a unit"),
        ({"exposure": "1.2.3 s"}, "exposure", "is not a number with a unit"),
        ({"exposure": "0 ms"}, "exposure", "greater than 0"),
        ({"exposure": "1e999 s"}, "exposure", "finite"),
        ({"exposure_s": math.nan}, "exposure_s", "finite"),
        ({"exposure": None}, "exposure", "valid number"),
        ({"buffer": "1.5 B"}, "buffer", "not a whole number of B"),
        ({"start": "1.5 steps"}, "start", "not a whole number of steps"),
        ({"start": 1.5}, "start", "valid integer"),
        ({"gain": "3 dBm"}, "gain", "'dBm'"),
    ],
)  # fmt: skip
def test_refusals(data: dict[str, object], key: str, fragment: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Sample.model_validate(data)
    (error,) = caught.value.errors()
    assert error["loc"][0] == key
    assert fragment in error["msg"]


def test_all_problems_at_once() -> None:
    with pytest.raises(ValidationError) as caught:
        Sample.model_validate({"exposure": 1, "gain": 2, "distance": "3 furlong", "more": 4})
    assert {error["loc"][0] for error in caught.value.errors()} == {"exposure", "gain", "distance", "more"}


def test_the_schema_describes_what_is_written() -> None:
    schema = Sample.model_json_schema()["properties"]
    assert schema["exposure"]["type"] == "string"
    assert "100 ms" in schema["exposure"]["examples"]
    assert schema["start"]["type"] == "integer"


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.1, "s", "100 ms"),
        (0.0, "s", "0 s"),
        (-0.25, "s", "-250 ms"),
        (90.0, "s", "90 s"),
        (0.34873, "m", "348.73 mm"),
        (8 * 2**20, "B", "8 MiB"),
        (1000, "B", "1000 B"),
        (3.0, "dB", "3 dB"),
        (1200, "steps", "1200 steps"),
    ],
)
def test_format(value: float, unit: str, text: str) -> None:
    assert format_quantity(value, unit) == text


def test_format_rounds_when_asked() -> None:
    assert format_quantity(0.0251345, "s", digits=4) == "25.13 ms"
    assert format_quantity(0.00099999, "s", digits=3) == "1 ms"
    assert format_quantity(31_171, "B", digits=3) == "30.4 KiB"


@given(st.floats(min_value=1e-12, max_value=1e9))
def test_times_round_trip(value: float) -> None:
    assert Sample.model_validate({"exposure": format_quantity(value, "s")}).exposure_s == value


@given(st.integers(min_value=0, max_value=2**60))
def test_sizes_round_trip(value: int) -> None:
    assert Sample.model_validate({"buffer": format_quantity(value, "B")}).buffer_bytes == value

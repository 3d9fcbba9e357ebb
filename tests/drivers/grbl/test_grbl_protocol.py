"""Lines, settings and numbers of GRBL, without a controller."""

import math
import random

import pytest

from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
    UnsupportedFeature,
)
from scanhsi_grbl.errors import alarm_error, reply_error
from scanhsi_grbl.protocol import Alarm, Banner, Error, Feedback, Message, Noise, Ok, Report, Setting, parse
from scanhsi_grbl.settings import read_axis

SETTINGS = {
    13: 0.0,
    20: 1.0,
    22: 1.0,
    23: 1.0,
    27: 1.0,
    100: 1000.0,
    110: 240.0,
    120: 20.0,
    130: 26.0,
    102: 53.333,
    112: 4500.0,
    122: 375.0,
    132: 360.0,
}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ok", Ok()),
        ("error:15", Error(15)),
        ("ALARM:3", Alarm(3)),
        ("Grbl 1.1h ['$' for help]", Banner("Grbl 1.1h ['$' for help]")),
        ("$100=53.333", Setting(100, 53.333)),
        ("$10=1 (status report options)", Setting(10, 1.0)),
        ("[VER:1.1h.20190830:]", Feedback("VER:1.1h.20190830:")),
        ("<Idle|MPos:1.000,-2.500,0.000|FS:0,0>", Report("Idle", 0, (1.0, -2.5, 0.0), None, None)),
        ("<Hold:1|WPos:1.000,0.000|WCO:2.000,0.000>", Report("Hold", 1, None, (1.0, 0.0), (2.0, 0.0))),
        (">G20:ok", Noise(">G20:ok")),
        ("<Idle|MPos:1.0x0,0,0>", Noise("<Idle|MPos:1.0x0,0,0>")),
        ("<Idxe|MPos:1.0,0,0>", Noise("<Idxe|MPos:1.0,0,0>")),
        ("<Idle|FS:0,0>", Noise("<Idle|FS:0,0>")),
        ("error:", Noise("error:")),
    ],
)
def test_lines(line: str, message: Message) -> None:
    assert parse(line) == message


def test_no_line_raises() -> None:
    chance = random.Random(1)
    for line in (
        "<Idle|MPos:1.000,-2.500,0.000|FS:0,0|WCO:0,0,0>",
        "$100=53.333",
        "error:15",
        "ALARM:3",
        "[VER:1.1h:]",
    ):
        for _ in range(300):
            damaged = "".join(chr(chance.randrange(1, 0x250)) if chance.random() < 0.1 else c for c in line)
            parse(damaged)


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (reply_error(8, "D", "L"), DeviceBusy),
        (reply_error(9, "D", "L"), PositionLost),
        (reply_error(5, "D", "L"), UnsupportedFeature),
        (reply_error(15, "D", "L"), OutOfRange),
        (reply_error(33, "D", "L"), ProtocolError),
        (alarm_error(1, "D", None), PositionLost),
        (alarm_error(2, "D", None), MotionFailed),
        (alarm_error(3, "D", None), PositionLost),
        (alarm_error(9, "D", "$H"), MotionFailed),
        (alarm_error(77, "D", "$H"), PositionLost),
    ],
)
def test_every_number_has_its_error(error: DeviceError, kind: type[DeviceError]) -> None:
    assert type(error) is kind
    assert error.device == "D"


def test_where_homing_ends_and_what_is_left_of_the_travel() -> None:
    down = read_axis(SETTINGS, "V", 0, "D")
    assert (down.home_step, down.travel_steps) == (-25_000, (-26_000, 0))
    up = read_axis({**SETTINGS, 23: 0.0}, "V", 0, "D")
    assert (up.home_step, up.travel_steps) == (-1000, (-26_000, 0))
    at_switch = read_axis(SETTINGS, "VZ", 0, "D")
    assert (at_switch.home_step, at_switch.travel_steps) == (0, (0, 26_000))
    free = read_axis({**SETTINGS, 20: 0.0, 22: 0.0}, "V", 0, "D")
    assert (free.home_step, free.travel_steps) == (0, (-math.inf, math.inf))


def test_the_axis_that_is_asked_for_is_read() -> None:
    degrees = read_axis(SETTINGS, "V", 2, "D")
    assert degrees.steps_per_mm == 53.333
    assert [degrees.steps(round(step / degrees.steps_per_mm, 3)) for step in (1, 2, -7, 9600)] == [1, 2, -7, 9600]
    assert degrees.move_time_s(8, degrees.rate_mm_min) == pytest.approx(2 * math.sqrt(8 / 20_000), rel=1e-3)
    assert degrees.move_time_s(4000, degrees.rate_mm_min) == pytest.approx(1.2, rel=1e-3)


@pytest.mark.parametrize(
    ("changed", "kind", "text"),
    [
        ({13: 1.0}, UnsupportedFeature, "inches"),
        ({100: 1600.0}, UnsupportedFeature, "single steps"),
        ({120: 0.0}, UnsupportedFeature, "acceleration"),
    ],
)
def test_settings_that_cannot_work_are_refused(changed: dict[int, float], kind: type[DeviceError], text: str) -> None:
    with pytest.raises(kind, match=text):
        read_axis({**SETTINGS, **changed}, "V", 0, "D")


def test_missing_settings_are_named() -> None:
    with pytest.raises(ProtocolError, match=r"\$101, \$111"):
        read_axis(SETTINGS, "V", 1, "D")

"""The mirror's true course, and who stands on a bench."""

import gc

import pytest

from scanhsi.devices.errors import DeviceBusy
from scanhsi_sim.bench import Bench, Mirror, bench


class Device:
    pass


def test_the_mirror_follows_its_course() -> None:
    mirror = Mirror()
    mirror.move(100, 200, 10)
    mirror.move(300, 400, -10)
    assert [mirror.position(t) for t in (0, 100, 150, 200, 250, 300, 350, 400, 999)] == [
        0,
        0,
        5,
        10,
        10,
        10,
        0,
        -10,
        -10,
    ]
    assert mirror.still_from_ns == 400


def test_a_span_holds_all_that_was_passed() -> None:
    mirror = Mirror()
    mirror.move(100, 200, 10)
    mirror.move(300, 400, -10)
    assert mirror.span(0, 100) == (0, 0)
    assert mirror.span(200, 300) == (10, 10)
    assert mirror.span(0, 101) == (0, 1)
    assert mirror.span(150, 350) == (0, 10)  # over the turning point
    assert mirror.span(0, 1000) == (-10, 10)


def test_a_span_is_not_widened_by_rounding() -> None:
    mirror = Mirror()
    mirror.move(0, 3_000_000_000, 999)
    for line in range(999):
        when = round(line / 333 * 1e9)
        assert mirror.span(when, when) == (line, line)


def test_halting_stops_at_the_nearest_step() -> None:
    mirror = Mirror()
    mirror.move(100, 200, 10)
    assert mirror.halt(157) == 6
    assert mirror.position(157) == mirror.position(500) == 6
    assert mirror.position(130) == pytest.approx(3)
    assert mirror.still_from_ns == 157
    assert mirror.halt(900) == 6
    assert mirror.still_from_ns == 157


def test_halting_before_a_motion_begins_leaves_the_mirror_alone() -> None:
    mirror = Mirror(4)
    mirror.move(100, 200, 10)
    assert mirror.halt(50) == 4
    assert mirror.position(150) == 4


def test_a_long_life_keeps_little() -> None:
    mirror = Mirror()
    for line in range(100_000):
        mirror.move(line * 10, line * 10 + 5, line)
    assert len(mirror._times) < 1000
    assert mirror.span(999_985, 999_985) == (99_998, 99_998)


def test_devices_of_one_bench_name_share_it_while_they_live() -> None:
    one = bench("shared")
    assert bench("shared") is one
    assert bench("another") is not one
    one.exposures = 7
    del one
    gc.collect()
    assert bench("shared").exposures == 0


def test_a_place_is_taken_once() -> None:
    here, first, second = Bench("b"), Device(), Device()
    here.claim("camera", first, "camera 1")
    here.claim("camera", first, "camera 1")
    here.claim("actuator", second, "actuator 1")
    with pytest.raises(DeviceBusy, match="bench 'b' has a connected camera already"):
        here.claim("camera", second, "camera 2")
    here.release("camera", second)  # not the owner
    with pytest.raises(DeviceBusy):
        here.claim("camera", second, "camera 2")
    here.release("camera", first)
    here.claim("camera", second, "camera 2")


def test_a_device_that_died_unclosed_holds_no_place() -> None:
    here, first, second = Bench("b"), Device(), Device()
    here.claim("camera", first, "camera 1")
    del first
    gc.collect()
    here.claim("camera", second, "camera 2")


def test_a_pulse_without_a_camera_is_lost() -> None:
    Bench("b").pulse(1)

"""The test pattern shows every mistake in every pixel."""

import itertools
import time

import numpy as np
import pytest

from scanhsi_sim.scenes import Geometry, load_scene
from scanhsi_sim.scenes.base import Image
from scanhsi_sim.scenes.testpattern import Decoded, decode, expected

SHAPE, OFFSET = (24, 40), (100, 424)


def render(
    step: int, end: int | None = None, bits: int = 12, shape: tuple[int, int] = SHAPE, offset: tuple[int, int] = OFFSET
) -> Image:
    return load_scene("testpattern").render(
        step, step if end is None else end, exposure_s=0.1, gain_db=0, shape=shape, offset=offset, bits=bits, index=3
    )


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("step", [0, 1, -1, 600, -2400, 123_456])
def test_a_frame_is_what_is_expected_and_tells_its_step(bits: int, step: int) -> None:
    frame = render(step, bits=bits)
    assert frame.dtype == (np.uint8 if bits == 8 else np.uint16)
    np.testing.assert_array_equal(frame, expected(step, SHAPE, OFFSET, bits))
    assert decode(frame, OFFSET, bits) == Decoded(step % 2**bits, moved=False)
    assert frame.max() < 2**bits


def test_it_uses_the_whole_range() -> None:
    assert np.unique(render(5, bits=8, shape=(64, 64))).size == 256
    assert np.unique(render(5, bits=12, shape=(512, 512))).size == 4096


@pytest.mark.parametrize(("bits", "reach"), [(8, 6), (12, 15)])
def test_any_small_displacement_is_wrong_in_every_pixel(bits: int, reach: int) -> None:
    """In bands, samples, steps or any combination of them. A pixel sees a displacement by the same amount everywhere."""
    home = int(expected(0, (1, 1), (100, 100), bits)[0, 0])
    around = range(-reach, reach + 1)
    for band, sample, step in itertools.product(around, around, around):
        if 0 < band**2 + sample**2 + step**2 <= reach**2:
            assert int(expected(step, (1, 1), (100 + band, 100 + sample), bits)[0, 0]) != home, (band, sample, step)


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("way", [1, 2, 3, 8, 50])
def test_motion_is_wrong_in_every_pixel(bits: int, way: int) -> None:
    frame = render(40, 40 + way, bits=bits)
    for step in range(40, 41 + way):
        assert (frame != expected(step, SHAPE, OFFSET, bits)).all()
    np.testing.assert_array_equal(frame, expected(40, SHAPE, OFFSET, bits, moved=True))
    assert decode(frame, OFFSET, bits) == Decoded(40, moved=True)


def test_damage_is_found_and_placed() -> None:
    frame = render(7)
    frame[5, 9] += 1
    with pytest.raises(ValueError, match=r"step 7.* 1 of 960 pixels differ, the first at band 5, sample 9"):
        decode(frame, OFFSET)
    torn = np.concatenate([render(7)[:12], render(8)[12:]])
    with pytest.raises(ValueError, match="480 of 960"):
        decode(torn, OFFSET)
    with pytest.raises(ValueError, match="not a frame"):
        decode(np.rot90(render(7, shape=(24, 24))).copy(), OFFSET)


def test_a_whole_frame_is_rendered_quickly() -> None:
    """Best of several, generously: about 1 ms, where a frame computed from scratch takes a hundred."""
    scene = load_scene("testpattern", Geometry())

    def once(step: int) -> float:
        began = time.perf_counter()
        scene.render(step, step, exposure_s=0.1, gain_db=0, shape=(1088, 2048), offset=(0, 0), bits=12, index=0)
        return time.perf_counter() - began

    once(0)
    assert min(once(step) for step in range(1, 12)) < 0.05

"""The paper's equations and tables, with its own numbers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanhsi.devices import PixelFormat
from scanhsi.timing import modalities
from scanhsi.timing.link import frame_rate_limit, transfer_s, wire_overhead
from scanhsi.timing.model import Terms, efficiency, image_s
from scanhsi.timing.smear import motion_mtf, period_for_smear_s, smear_part

SENSOR = (1088, 2048)
MONO8, PACKED, UNPACKED = PixelFormat.MONO8, PixelFormat.MONO12_PACKED, PixelFormat.MONO12


@pytest.mark.parametrize(
    ("pixel_format", "ms", "fps"), [(MONO8, 18.164, 55.05), (PACKED, 27.247, 36.70), (UNPACKED, 36.329, 27.53)]
)
def test_eq_2(pixel_format: PixelFormat, ms: float, fps: float) -> None:
    """The printed 55.06 and 27.04 FPS are slips (1 / 18.164 ms, 1 / 27.247 ms)."""
    t_rx_s = transfer_s(SENSOR, pixel_format)
    assert t_rx_s * 1e3 == pytest.approx(ms, abs=5e-4)
    assert 1 / t_rx_s == pytest.approx(fps, abs=5e-3)


@pytest.mark.parametrize(
    ("packet_size", "overhead", "ms8", "ms16"), [(1500, 1.0505, 18.73, 37.45), (8228, 1.0090, 17.99, 35.97)]
)
def test_true_overhead(packet_size: int, overhead: float, ms8: float, ms16: float) -> None:
    assert wire_overhead(packet_size) == pytest.approx(overhead, abs=5e-5)
    times_s = [transfer_s(SENSOR, kind, overhead=wire_overhead(packet_size)) for kind in (MONO8, UNPACKED)]
    assert [time_s * 1e3 for time_s in times_s] == pytest.approx([ms8, ms16], abs=0.005)


def test_a_region_of_interest_is_sent_faster() -> None:
    times_s = [transfer_s((1088, 1200), kind) for kind in (MONO8, PACKED, UNPACKED)]
    assert [time_s * 1e3 for time_s in times_s] == pytest.approx([10.64, 15.96, 21.29], abs=0.005)
    assert transfer_s(SENSOR, MONO8, link_bits_s=124e6 * 8, overhead=1.0) == pytest.approx(17.97e-3, abs=1e-5)
    with pytest.raises(ValueError, match="packet_size must be above the 36 bytes of its headers, not 36"):
        wire_overhead(36)


def test_frame_rate_limits() -> None:
    assert frame_rate_limit(0.01, readout_s=1 / 49.5) == pytest.approx(49.5)
    assert frame_rate_limit(0.01, readout_s=1 / 49.5, transfer_s=transfer_s(SENSOR, UNPACKED)) == pytest.approx(
        27.5, abs=0.05
    )
    assert frame_rate_limit(0.1, readout_s=0.02, dead_s=0.001) == pytest.approx(1 / 0.101)
    assert frame_rate_limit(0.1, readout_s=0.02, overlap=False) == pytest.approx(1 / 0.12)


PAPER = Terms(T_exp_s=0.1, T_rx_s=18.16e-3, T_api_s=2.04e-3, T_mcpy_s=2.2e-3, T_act_s=10.69e-3, T_rand_s=0.24e-3)


@pytest.mark.parametrize(("exposure_s", "expected"), [(0.1, 0.750), (0.2, 0.857), (0.3, 0.900)])
def test_eq_1_3_and_4(exposure_s: float, expected: float) -> None:
    terms = Terms(**{f"{name}_s": PAPER.get(name) for name in Terms.names() if name != "T_exp"}, T_exp_s=exposure_s)
    assert terms.extra_s * 1e3 == pytest.approx(33.09)  # T_rand stands beside it
    assert terms.line_s == pytest.approx(exposure_s + 33.33e-3)
    assert terms.efficiency == pytest.approx(expected, abs=5e-4)
    assert terms.efficiency == pytest.approx(exposure_s * terms.lines_per_second)


@given(st.floats(1e-6, 1e3), st.floats(1e-6, 1e3), st.floats(0, 1e3))
def test_efficiency_grows_to_one(shorter_s: float, by_s: float, extra_s: float) -> None:
    low = efficiency(shorter_s, shorter_s + extra_s)
    high = efficiency(shorter_s + by_s, shorter_s + by_s + extra_s)
    assert 0 < low <= high <= 1


def test_a_hand_takes_280_s() -> None:
    """1200 lines of 200 ms; the paper's N T_line / efficiency would be 326.7 s."""
    assert image_s(1200, 0.2 + 33.33e-3) == pytest.approx(280.0, abs=0.005)
    assert image_s(10, 0.1, home_s=2, return_s=1) == pytest.approx(4.0)


def test_table_6() -> None:
    assert modalities.snapshot_s(0.1) == 0.1
    assert modalities.staring_s(0.1, 0.05, 31) == pytest.approx(4.65)
    assert modalities.whiskbroom_s(0.001, 0.002, 20, 30) == pytest.approx(1.8)
    assert modalities.pushbroom_s(0.1, 0.2, 100) == pytest.approx(30)
    assert modalities.rotating_mirror_s(0.1, 0.01, 100) == pytest.approx(11)


def test_smear() -> None:
    assert smear_part(0.02, 0.04) == 0.5
    assert motion_mtf(1.0) == pytest.approx(2 / math.pi)
    assert motion_mtf(0.5) == pytest.approx(0.9003, abs=1e-4)
    assert motion_mtf(0.0) == 1.0
    assert motion_mtf(0.5, frequency=0.25) > motion_mtf(0.5)
    assert period_for_smear_s(0.02, 0.25) == pytest.approx(0.08)
    with pytest.raises(ValueError, match="part must be above 0"):
        period_for_smear_s(0.02, 0)

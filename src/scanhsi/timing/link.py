"""The camera's link: how long a frame is on the wire, and which frame rate that leaves (Sensors 2019, 19(7), 1692, Eq. 2).

The paper's overhead of 1.019 is 1500 / 1472: it counts the headers of IP and UDP only. `wire_overhead` also counts those of GVSP
and of Ethernet with its gaps, which makes 1.0505 at the usual packet size of 1500 bytes and 1.009 with jumbo frames.
"""

from __future__ import annotations

from typing import Final

from scanhsi.devices import PixelFormat

GIGABIT_S: Final = 1e9
"""Bit rate of Gigabit Ethernet, bit/s."""
PAPER_OVERHEAD: Final = 1.019
"""Omega of Eq. 2."""
_ETHERNET_BYTES: Final = 14 + 4 + 8 + 12  # header, checksum, preamble, gap
_HEADER_BYTES: Final = 20 + 8 + 8  # IP, UDP, GVSP


def wire_overhead(packet_size: int = 1500) -> float:
    """Bytes on the wire for each byte of a frame, over GigE Vision.

    The packets that open and close a frame, about 2 us of Gigabit Ethernet, are not counted.

    Args:
        packet_size: Of stream packets in bytes, IP header included, as ``GevSCPSPacketSize`` counts.

    Raises:
        ValueError: Too small to carry anything.
    """
    if packet_size <= _HEADER_BYTES:
        raise ValueError(f"packet_size must be above the {_HEADER_BYTES} bytes of its headers, not {packet_size}")
    return (packet_size + _ETHERNET_BYTES) / (packet_size - _HEADER_BYTES)


def transfer_s(
    shape: tuple[int, int],
    pixel_format: PixelFormat,
    *,
    link_bits_s: float = GIGABIT_S,
    overhead: float = PAPER_OVERHEAD,
) -> float:
    """Time T_rx of a frame on the link (Eq. 2), in s.

    Args:
        shape: (bands, samples) that are *sent*. Most cameras send the region of interest; the paper's instrument sends all
            2048 samples and keeps 1200 of them.
        pixel_format: Its bits on the wire count: 12-bit pixels take 12 bits packed and 16 unpacked.
        link_bits_s: Bit rate of the link, or what a camera is allowed of it.
        overhead: Of the protocol; `wire_overhead` has the true one for a packet size.
    """
    return pixel_format.payload_bytes(shape) * 8 * overhead / link_bits_s


def frame_rate_limit(
    exposure_s: float, *, readout_s: float, transfer_s: float = 0.0, dead_s: float = 0.0, overlap: bool = True
) -> float:
    """Highest frame rate of a free-running camera, in frames/s.

    Args:
        exposure_s: Exposure time.
        readout_s: Sensor read-out. A smaller number of *samples* does not shorten it on a sensor read by rows.
        transfer_s: Time of a frame on the link, API included.
        dead_s: Between one exposure and the next.
        overlap: Whether the sensor exposes while it reads the last frame out.
    """
    sensor_s = max(exposure_s + dead_s, readout_s) if overlap else exposure_s + readout_s
    return 1 / max(sensor_s, transfer_s)

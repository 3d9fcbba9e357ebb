"""Lines that a sweep loses: nothing holds the mirror back, so a frame that finds no free buffer is gone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanhsi.timing.bounds import LineDelays


def lost(delays: LineDelays, period_ns: int) -> NDArray[np.bool_]:
    """Which lines of a sweep are lost, bool (n,).

    A frame needs a buffer of the camera when its first row comes: that of the line ``buffers`` earlier, once it is unpacked. And it
    needs a line buffer of storage when it is taken: that of the line ``line_buffers`` earlier, once it is stored.

    Args:
        delays: Of its lines.
        period_ns: Time from line to line.
    """
    count = len(delays.exposure)
    copied, stored = [0] * count, [0] * count
    gone = np.zeros(count, np.bool_)
    received = 0
    columns = (delays.exposure, delays.transfer, delays.copy, delays.store)
    for line, (exposure, transfer, copy, store) in enumerate(zip(*(each.tolist() for each in columns), strict=True)):
        ended = line * period_ns + exposure
        first_row = max(ended + delays.first_row_ns, received)
        received = max(first_row + transfer, ended + delays.readout_ns if delays.whole_frame else 0)
        taken = max(received, copied[line - 1]) if line else received
        camera_full = line >= delays.buffers and copied[line - delays.buffers] > first_row
        storage = delays.line_buffers
        storage_full = storage is not None and line >= storage and stored[line - storage] > taken
        gone[line] = camera_full or storage_full
        copied[line] = taken + (0 if gone[line] else copy)
        behind = stored[line - 1] if line else 0
        stored[line] = max(copied[line], behind) + (0 if gone[line] else store)
    return gone

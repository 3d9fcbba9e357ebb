"""How early a move may be sent, so that the mirror begins to move as the exposure ends and not before.

Latency is the time from a command to the begin of its motion: serial exchange, parsing, the host's disturbances. Sent earlier by
*lead*, the motion begins too early if this move's latency is shorter than the lead.
"""

from __future__ import annotations

import bisect
import math
from collections import deque

_LEAST_WINDOW = 1000


class Latencies:
    """Latencies of the last moves of a scan, and the lead that they allow.

    No distribution is assumed. Of n + 1 latencies, in whatever order they come with the same probability, the last is among the k
    shortest with probability k / (n + 1); so the k-th shortest of n as the lead makes the next motion begin too early with at most
    that. k is as large as the accepted probability allows: before 1 / probability moves were seen, only what is sure is led by.

    Args:
        probability: Accepted, of each line.
    """

    def __init__(self, probability: float) -> None:
        self._probability = probability
        window = max(_LEAST_WINDOW, math.ceil(10 / probability)) if probability else 1
        self._latest: deque[int] = deque(maxlen=window)  # not all: what a device does may change in a long scan
        self._sorted: list[int] = []

    def add(self, latency_ns: int) -> None:
        """Note the latency of a move."""
        if len(self._latest) == self._latest.maxlen:
            del self._sorted[bisect.bisect_left(self._sorted, self._latest[0])]
        self._latest.append(latency_ns)
        bisect.insort(self._sorted, latency_ns)

    def lead_ns(self, least_ns: int) -> int:
        """By how much to send the next move before the end of the exposure.

        Args:
            least_ns: Latency that this move does not stay below.
        """
        rank = math.floor(self._probability * (len(self._sorted) + 1) + 1e-9)
        return max(least_ns, self._sorted[rank - 1] if rank else 0)

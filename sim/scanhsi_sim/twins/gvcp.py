"""Listens to the camera's control traffic, to know of a software trigger when it comes in.

Aravis' fake camera serves GVCP only between frames: while it sends one, a trigger waits. A real sensor does not. So the
twin reads a copy of each control packet as it passes loopback, with the kernel's time stamp.
"""

import ctypes
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass

PORT = 3956
_ETH_P_IP = 0x0800
_SO_ATTACH_FILTER = 26
_SO_TIMESTAMPNS = 35
_COMMAND, _ACKNOWLEDGE = 0x42, 0x00
_WRITE_REGISTER, _WRITE_MEMORY = 0x82, 0x86
_WRITE_ACKNOWLEDGES = (0x83, 0x87)


@dataclass(frozen=True, slots=True)
class Write:
    """The application in control writes a register. The camera may not have seen it yet.

    Attributes:
        address: Of the first register.
        value: Of that register.
        host_ns: When the packet arrived, CLOCK_MONOTONIC.
    """

    address: int
    value: int
    host_ns: int


@dataclass(frozen=True, slots=True)
class Written:
    """The camera has acknowledged a write: its registers may have changed.

    Attributes:
        taken_over: The application is not the one that wrote before.
    """

    taken_over: bool


class Listener:
    """Copies of the GVCP packets of one camera on loopback. Select on it, then `receive`."""

    def __init__(self) -> None:
        """Open it; needs CAP_NET_RAW, which a private network namespace gives."""
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(_ETH_P_IP))
        self._socket.setblocking(False)
        _attach_filter(self._socket)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.bind(("lo", _ETH_P_IP))
        self._controller = b""
        self._last = b""

    def fileno(self) -> int:
        """For select."""
        return self._socket.fileno()

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def receive(self) -> Iterator[Write | Written]:
        """What has come, oldest first; does not wait for more."""
        while True:
            try:
                packet, ancillary, _, _ = self._socket.recvmsg(2048, 256)
            except BlockingIOError:
                return
            event = self._understand(packet, ancillary)
            if event is not None:
                yield event

    def _understand(self, packet: bytes, ancillary: list[tuple[int, int, bytes]]) -> Write | Written | None:
        header = (packet[0] & 0x0F) * 4
        source, target = struct.unpack_from("!HH", packet, header)
        gvcp = packet[header + 8 :]
        if len(gvcp) < 8:
            return None
        kind, _, command, _, _ = struct.unpack_from("!BBHHH", gvcp)
        if source == PORT and kind == _ACKNOWLEDGE and command in _WRITE_ACKNOWLEDGES:
            # only the application in control gets its writes acknowledged: so this tells who that is
            before, self._controller = self._controller, packet[16:20] + packet[header + 2 : header + 4]
            return Written(taken_over=before != self._controller)
        sender = packet[12:16] + packet[header : header + 2]
        if target != PORT or kind != _COMMAND or sender != self._controller or len(gvcp) < 16:
            return None
        if command not in (_WRITE_REGISTER, _WRITE_MEMORY) or sender + gvcp == self._last:
            return None  # the last case: sent again because the acknowledgement was late
        self._last = sender + gvcp
        address, value = struct.unpack_from("!II", gvcp, 8)
        return Write(address, value, _arrival_ns(ancillary))


def _arrival_ns(ancillary: list[tuple[int, int, bytes]]) -> int:
    """The kernel's time stamp, moved from CLOCK_REALTIME to CLOCK_MONOTONIC."""
    now_ns = time.monotonic_ns()
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = struct.unpack_from("@qq", data)
            age_ns = time.time_ns() - (seconds * 1_000_000_000 + nanoseconds)
            return now_ns - max(0, min(age_ns, 1_000_000_000))  # a clock being set must not move it far
    return now_ns


def _attach_filter(packets: socket.socket) -> None:
    """Let only UDP packets from or to the GVCP port pass: image data goes over the same loopback."""
    program = [
        (0x30, 0, 0, 9),  # A = protocol of the IP header
        (0x15, 0, 5, socket.IPPROTO_UDP),  # else reject
        (0xB1, 0, 0, 0),  # X = length of the IP header
        (0x48, 0, 0, 0),  # A = source port
        (0x15, 3, 0, PORT),  # accept
        (0x48, 0, 0, 2),  # A = destination port
        (0x15, 1, 0, PORT),  # accept
        (0x06, 0, 0, 0),  # reject
        (0x06, 0, 0, 0xFFFF),  # accept
    ]
    code = b"".join(struct.pack("HBBI", *instruction) for instruction in program)
    memory = ctypes.create_string_buffer(code, len(code))
    packets.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HL", len(program), ctypes.addressof(memory)))

"""A link to a server that is slow, or broken: a proxy on loopback that passes so many bytes a second."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager

_PIECE = 16_384


class SlowLink:
    """The proxy; its settings may change at any time.

    Attributes:
        bytes_per_s: To the server, all connections together; back they go as they come.
        broken: Connections are reset, new ones refused, for as long as this is set.
        sent: Bytes that went to the server.
    """

    def __init__(self, host: str, port: int, bytes_per_s: float) -> None:
        self.bytes_per_s = bytes_per_s
        self.broken = False
        self.sent = 0
        self._target = (host, port)
        self._next_s = time.monotonic()
        self._taking = threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._open: set[socket.socket] = set()
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def cut(self) -> None:
        """Break it now, in the middle of whatever is under way."""
        self.broken = True
        for connection in list(self._open):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        """Take connections again."""
        self.broken = False

    def close(self) -> None:
        self.cut()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            if self.broken:
                client.close()
                continue
            try:
                server = socket.create_connection(self._target)
            except OSError:
                client.close()
                continue
            self._open |= {client, server}
            for source, target, slow in ((client, server, True), (server, client, False)):
                threading.Thread(target=self._pass, args=(source, target, slow), daemon=True).start()

    def _pass(self, source: socket.socket, target: socket.socket, slow: bool) -> None:
        try:
            while piece := source.recv(_PIECE):
                if slow:
                    self._wait(len(piece))
                target.sendall(piece)
        except OSError:
            pass
        for end in (source, target):
            self._open.discard(end)
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            if slow:
                end.close()

    def _wait(self, size: int) -> None:
        with self._taking:
            self.sent += size
            self._next_s = max(self._next_s, time.monotonic()) + size / self.bytes_per_s
            wait_s = self._next_s - time.monotonic()
        if wait_s > 0:
            time.sleep(wait_s)


@contextmanager
def slow_link(endpoint: str, bytes_per_s: float = 1e9) -> Generator[SlowLink]:
    host, _, port = endpoint.removeprefix("http://").partition(":")
    link = SlowLink(host, int(port), bytes_per_s)
    try:
        yield link
    finally:
        link.close()

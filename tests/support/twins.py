"""The camera's twin in blocking words, for tests that block in Aravis."""

import asyncio
import threading
from collections.abc import Coroutine, Generator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

from scanhsi_sim.twins.camera_twin import CameraTwin, CameraTwinSettings


class Loop:
    """Runs the asyncio side of a twin beside a test that blocks in Aravis."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()

    def run(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        future: Future[Any] = asyncio.run_coroutine_threadsafe(coroutine, self.loop)
        return future.result(60)

    def close(self) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


class Running:
    """A twin, in blocking words."""

    def __init__(self, loop: Loop, twin: CameraTwin) -> None:
        self.loop, self.twin = loop, twin

    def stats(self) -> dict[str, Any]:
        return self.loop.run(self.twin.stats())

    def command(self, text: str) -> str:
        return self.loop.run(self.twin.command(text))


@contextmanager
def running(**settings: Any) -> Generator[Running]:
    loop = Loop()
    twin = CameraTwin(CameraTwinSettings(**settings))
    try:
        loop.run(twin.__aenter__())
        try:
            yield Running(loop, twin)
        finally:
            loop.run(twin.__aexit__(None, None, None))
    finally:
        loop.close()

"""Ten thousand lines beside viewers: memory stays flat. By hand: ``pytest -m soak tests/service/test_service_soak.py``."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from pathlib import Path

import pytest

from scanhsi.client import connect_instrument
from support.server import serving

LINES = 10_000
ROOM_MB = 16
"""The colour picture, 6 MB, which fills as the scan goes on, and what allocators come to hold."""


def memory_mb(pid: int) -> float:
    """Of a process, without what it shares with files."""
    told = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in told if line.startswith("RssAnon")) / 1000


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_memory_is_flat_over_ten_thousand_lines(tmp_path: Path) -> None:
    ideal = ("camera.profile=ideal", "actuator.profile=ideal", "camera.scene=testpattern")
    with serving(tmp_path, *ideal) as server:
        seen: list[tuple[int, float]] = []

        async def view(hsi: object) -> None:
            assert hasattr(hsi, "preview")
            async with aclosing(hsi.preview()) as frames:
                async for _ in frames:
                    pass

        async def main() -> None:
            async with connect_instrument(server.url, download=False) as hsi:
                viewers = [asyncio.ensure_future(view(hsi)) for _ in range(3)]
                plan = hsi.default_plan(lines=LINES, exposure="10 ms", step=0, mode="stepped")
                report = await hsi.scan(
                    plan, None, on_progress=lambda told: seen.append((told.taken, memory_mb(server.process.pid)))
                )
                assert report.missing == 0
                for viewer in viewers:
                    viewer.cancel()
                await asyncio.gather(*viewers, return_exceptions=True)

        asyncio.run(main())
    early = max(mb for line, mb in seen if line <= LINES / 10)
    late = max(mb for line, mb in seen if line >= LINES / 2)
    print([seen[place] for place in range(0, len(seen), max(1, len(seen) // 12))])  # noqa: T201 what was measured
    assert late - early < ROOM_MB, seen

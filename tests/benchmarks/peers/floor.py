"""Bare asyncio: what any asyncio program pays that moves, exposes and stores in two tasks. No errors, no deadlines, no records."""

from __future__ import annotations

import asyncio
from asyncio import Queue

import numpy as np
from work import Blocks, Watch, Work, make_frames


def scan(work: Work, watch: Watch) -> np.ndarray | None:
    frames = make_frames()

    async def control(lines: Queue[int | None]) -> None:
        for line in range(work.lines):
            await asyncio.sleep(0)  # move
            await asyncio.sleep(0)  # expose
            watch.line_over()
            await lines.put(line)
        await lines.put(None)

    async def store(lines: Queue[int | None], blocks: Blocks | None) -> None:
        writing = None
        while (line := await lines.get()) is not None:
            if blocks is None:
                continue
            blocks.take(line, frames[line % len(frames)])
            if blocks.full(line):
                if writing is not None:
                    await writing
                writing = asyncio.get_running_loop().run_in_executor(None, blocks.write, line, blocks.swap())
        if writing is not None:
            await writing

    async def both() -> Blocks | None:
        blocks = None if work.store is None else Blocks(work.store, work.lines)
        lines: Queue[int | None] = Queue(8)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(control(lines))
            tasks.create_task(store(lines, blocks))
        return blocks

    with watch.running():
        blocks = asyncio.run(both())
    return None if blocks is None else blocks.read()

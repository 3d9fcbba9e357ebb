"""What is seen of a running scan: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

    from scanhsi.engine import Progress

_BAR_PERIOD_S: Final = 0.25
_LINE_PERIOD_S: Final = 5.0


@contextmanager
def shown(console: Console) -> Generator[Callable[[Progress], None]]:
    """Show progress on a console: yields what to call with each `Progress`.

    Calls may come as often as they like; what is drawn is limited by the clock on the wall, not by that of the loop, because
    the reader's eyes live there, also when the scan runs in virtual time.
    """
    if console.is_terminal:
        with _bar(console) as show:
            yield _at_most_every(_BAR_PERIOD_S, show)
    else:
        yield _at_most_every(_LINE_PERIOD_S, lambda progress: console.print(describe(progress), soft_wrap=True))


@contextmanager
def bytes_shown(console: Console, doing: str) -> Generator[Callable[[int, int], None]]:
    """Show how far something got that goes through the pixels of a cube: yields what to call with bytes done and to do."""
    began, due = time.monotonic(), 0.0

    def describe_bytes(done: int, total: int) -> str:
        passed = max(time.monotonic() - began, 1e-3)
        left = clock(passed * (total - done) / done) if done else "?"
        return (
            f"{doing} {done / max(total, 1):.0%} of {total / 1e6:.0f} MB, {done / passed / 1e6:.0f} MB/s, {left} left"
        )

    if not console.is_terminal:
        due = began + _LINE_PERIOD_S  # what is done before that needs no words

    def show(done: int, total: int) -> None:
        nonlocal due
        now = time.monotonic()
        if now < due:
            return
        due = now + (_BAR_PERIOD_S if console.is_terminal else _LINE_PERIOD_S)
        if status is None:
            console.print(describe_bytes(done, total), soft_wrap=True)
        else:
            status.update(describe_bytes(done, total))

    status = console.status(doing) if console.is_terminal else None
    with status or nullcontext():
        yield show


def describe(progress: Progress) -> str:
    """One line: lines, lines/s, efficiency, time left, lost lines."""
    return (
        f"{_state(progress)}line {progress.taken + progress.missing}/{progress.lines}, {progress.lines_per_second:.1f} lines/s, "
        f"efficiency {progress.efficiency:.1%}, {clock(progress.remaining_s)} left, {progress.missing} lost"
    )


def _state(progress: Progress) -> str:
    return "" if progress.state == "scanning" else f"{progress.state}, "


def clock(seconds: float) -> str:
    """A duration as minutes and seconds: ``1:05``."""
    if not 0 <= seconds < 360_000:
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


@contextmanager
def _bar(console: Console) -> Generator[Callable[[Progress], None]]:
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bars

    bars = Bars(
        BarColumn(bar_width=None),
        TextColumn("{task.fields[facts]}", markup=False),
        console=console,
        auto_refresh=False,
        expand=True,
    )
    with bars:
        task = bars.add_task("", total=None, facts="homing")

        def show(progress: Progress) -> None:
            done = progress.taken + progress.missing
            facts = (
                f"{_state(progress)}{done}/{progress.lines} lines  {progress.lines_per_second:.1f} lines/s  "
                f"efficiency {progress.efficiency:.1%}  {clock(progress.remaining_s)} left  {progress.missing} lost"
            )
            bars.update(task, total=progress.lines, completed=done, facts=facts)
            bars.refresh()

        yield show


def _at_most_every(period_s: float, show: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """Let a call pass when the last that passed is long enough ago, when it is the last of the scan, or the state is another."""
    due, state = 0.0, "scanning"

    def limited(progress: Progress) -> None:
        nonlocal due, state
        now = time.monotonic()
        if now >= due or progress.taken + progress.missing >= progress.lines or progress.state != state:
            due, state = now + period_s, progress.state
            show(progress)

    return limited

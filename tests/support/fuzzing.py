"""Random scans in a test: what fails is told with the command that runs it again."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from scanhsi.testing.cases import draw
from scanhsi.testing.fuzz import Verdict, fuzz, replay_command


def clean(seed: int, scans: range) -> None:
    """Run scans of a seed and fail with all that is wrong, if any is."""
    with silence():
        failures = [verdict for verdict in fuzz(seed, scans) if verdict.violations]
    assert not failures, "\n".join(told(seed, verdict) for verdict in failures)


def told(seed: int, verdict: Verdict) -> str:
    """One failure, for people."""
    texts = "".join(f"\n    {name}: {text}" for name, text in verdict.violations.items())
    again = f"scanhsi-fuzz --seed {seed} --scan {verdict.scan}    # shrinks it"
    return f"scan {verdict.scan} ended {verdict.ended}:{texts}\n  {again}\n  {replay_command(draw(seed, verdict.scan))}"


@contextmanager
def silence() -> Iterator[None]:
    """Thousands of scans go wrong on purpose: what they log is of no interest."""
    logging.disable()
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)

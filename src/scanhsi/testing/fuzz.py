"""``scanhsi-fuzz``: thousands of broken scans, each reproducible from its seed, and what must hold after each.

::

    scanhsi-fuzz --scans 10000 --seed 7         # random scans 0 to 9999 of seed 7
    scanhsi-fuzz --seed 7 --scan 4711           # one of them again
    scanhsi-fuzz --replay '{"plan": ...}'       # one that was shrunk, as printed
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import multiprocessing
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from scanhsi.testing.cases import Case, draw
from scanhsi.testing.checks import check
from scanhsi.testing.runs import run, warm_up
from scanhsi.testing.shrink import shrink

WATCHDOG_S: Final = 60.0
"""Real time in which one scan must have ended, on a busy computer too: usually it takes 0.05 s."""


@dataclass(slots=True)
class Verdict:
    """What one scan came to.

    Attributes:
        scan: Its number.
        ended: ``ok``, ``stopped``, ``cancelled``, or the name of its exception.
        violations: Names of invariants that it broke -> how.
        happened: Kinds of faults that happened.
    """

    scan: int
    ended: str
    violations: dict[str, str]
    happened: tuple[str, ...] = ()


@dataclass(slots=True)
class Tally:
    """What many scans came to.

    Attributes:
        scans: How many.
        ended: How, and how often.
        happened: Kinds of faults, and in how many scans.
        failures: Scans that broke an invariant.
    """

    scans: int = 0
    ended: Counter[str] = field(default_factory=Counter[str])
    happened: Counter[str] = field(default_factory=Counter[str])
    failures: list[Verdict] = field(default_factory=list[Verdict])

    def add(self, verdict: Verdict) -> None:
        """Count a scan."""
        self.scans += 1
        self.ended[verdict.ended] += 1
        self.happened.update(verdict.happened)
        if verdict.violations:
            self.failures.append(verdict)


def judge(case: Case, scan: int = 0) -> Verdict:
    """Run one case and check it."""
    with run(case) as outcome:
        violations: dict[str, str] = {}
        for violation in check(outcome):
            violations.setdefault(violation.name, violation.text)
    ended = "cancelled" if outcome.cancelled else type(outcome.error).__name__
    if outcome.report is not None and outcome.error is None:
        ended = "stopped" if outcome.report.stopped_early else "ok"
    return Verdict(scan, ended, violations, tuple(sorted(outcome.faults.kinds())))


Judge = Callable[[Case, int], Verdict]


def fuzz(seed: int | str, scans: Sequence[int]) -> Iterator[Verdict]:
    """Run scans of a seed, in this process."""
    warm_up()
    for scan in scans:
        yield judge(draw(seed, scan), scan)


def smallest(case: Case, names: set[str]) -> Case:
    """Shrink a case that breaks any of these invariants."""
    return shrink(case, lambda smaller: bool(names & set(_judged(smaller))))


def replay_command(case: Case) -> str:
    """The one command that runs a case again."""
    return f"scanhsi-fuzz --replay {shlex.quote(case.text())}"


def _judged(case: Case) -> dict[str, str]:
    try:
        return judge(case).violations
    except ValueError:  # a plan that cannot be: not smaller, but nonsense
        return {}


# --- processes ------------------------------------------------------------------------------------------------------------


def _work(seed: int | str, scans: Sequence[int], to_parent: Any, watchdog_s: float, judged: Judge) -> None:
    """Run scans in a process of its own, which ends itself when one of them hangs."""
    logging.disable()
    warm_up()
    for scan in scans:
        faulthandler.dump_traceback_later(watchdog_s, exit=True)
        to_parent.send(scan)
        to_parent.send(judged(draw(seed, scan), scan))
    faulthandler.cancel_dump_traceback_later()
    to_parent.close()


@dataclass(slots=True)
class _Worker:
    process: Any
    waiting: list[int]
    running: int | None = None


def in_processes(
    seed: int | str, scans: Sequence[int], jobs: int, watchdog_s: float = WATCHDOG_S, judged: Judge = judge
) -> Iterator[Verdict]:
    """Run scans of a seed in several processes; one that does not end for real is told and the others go on."""
    context = multiprocessing.get_context("spawn")
    workers: dict[Connection, _Worker] = {}

    def start(part: list[int]) -> None:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(seed, part, theirs, watchdog_s, judged), daemon=True)
        process.start()
        theirs.close()
        workers[ours] = _Worker(process, part)

    for number in range(jobs):
        if part := list(scans[number::jobs]):
            start(part)
    while workers:
        for ready in wait(list(workers)):
            assert isinstance(ready, Connection)
            worker = workers[ready]
            try:
                told = ready.recv()
            except EOFError:
                del workers[ready]
                worker.process.join()
                if worker.running is not None:
                    text = f"a process ended with code {worker.process.exitcode}, perhaps after {watchdog_s:g} s"
                    yield Verdict(worker.running, "killed", {"it hangs for real": text})
                if worker.waiting:
                    start(worker.waiting)
                continue
            if isinstance(told, Verdict):
                worker.running = None
                yield told
            else:
                worker.running = told
                worker.waiting = worker.waiting[1:]


# --- the command ----------------------------------------------------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> int:
    """The command ``scanhsi-fuzz``; returns 1 when an invariant was broken."""
    options = _options(arguments)
    logging.disable()
    if options.replay is not None:
        return _one(options.replay, "the case", shrinks=False)
    if options.scan is not None:
        case = draw(options.seed, options.scan)
        return _one(case, f"scan {options.scan} of seed {options.seed}", shrinks=not options.no_shrink)
    began = time.monotonic()
    tally = Tally()
    _say(f"{options.scans} scans of seed {options.seed} in {options.jobs} processes")
    for verdict in in_processes(options.seed, range(options.scans), options.jobs, options.watchdog):
        tally.add(verdict)
        if verdict.violations:
            _say(f"scan {verdict.scan}: {', '.join(verdict.violations)}")
        if tally.scans % 1000 == 0:
            _say(f"{tally.scans} scans, {len(tally.failures)} failures, {time.monotonic() - began:.0f} s")
    _say(_summary(tally, time.monotonic() - began))
    for verdict in sorted(tally.failures, key=lambda failure: failure.scan)[: options.show]:
        _show(verdict, options.seed, shrinks=not options.no_shrink)
    return bool(tally.failures)


def today() -> int:
    """The seed of the day."""
    return int(datetime.now(UTC).strftime("%Y%m%d"))


def _case(told: str) -> Case:
    try:
        return Case.model_validate_json(told if told.lstrip().startswith("{") else Path(told).read_text())
    except OSError as error:
        raise argparse.ArgumentTypeError(f"cannot read {told}: {error.strerror}") from error
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
        raise argparse.ArgumentTypeError(f"no case of scanhsi-fuzz: {wrong}") from error


def _count(told: str) -> int:
    if (number := int(told)) < 1:
        raise argparse.ArgumentTypeError(f"{number} is too few: at least 1")
    return number


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "scanhsi-fuzz", description="Random scans that go wrong, and what must hold after each."
    )
    parser.add_argument("--seed", type=int, default=today(), help="of all scans; default: the date of today")
    parser.add_argument("--scans", type=_count, metavar="N", default=1000, help="how many (1000)")
    parser.add_argument("--scan", type=int, metavar="K", help="run this scan of the seed only")
    parser.add_argument("--replay", metavar="CASE", type=_case, help="run a case: JSON, or a file of it")
    parser.add_argument("--jobs", type=_count, metavar="N", default=2, help="processes (2)")
    parser.add_argument(
        "--watchdog", type=float, metavar="S", default=WATCHDOG_S, help="real seconds that a scan may take (60)"
    )
    parser.add_argument("--show", type=int, metavar="N", default=3, help="failures to shrink and show (3)")
    parser.add_argument("--no-shrink", action="store_true", help="show failures as they were drawn")
    return parser.parse_args(arguments)


def _one(case: Case, name: str, *, shrinks: bool) -> int:
    warm_up()
    verdict = judge(case)
    _say(f"{name}: {verdict.ended}; what happened: {', '.join(verdict.happened) or 'nothing'}")
    if not verdict.violations:
        return 0
    _tell(verdict)
    if shrinks:
        case = smallest(case, set(verdict.violations))
    _say(f"  replay: {replay_command(case)}")
    return 1


def _show(verdict: Verdict, seed: int, *, shrinks: bool) -> None:
    _say(f"\nscan {verdict.scan} of seed {seed}: {verdict.ended}")
    _tell(verdict)
    if "it hangs for real" in verdict.violations or not shrinks:
        _say(f"  replay: scanhsi-fuzz --seed {seed} --scan {verdict.scan}")
        return
    case = smallest(draw(seed, verdict.scan), set(verdict.violations))
    for fault in case.faults.faults:
        _say(f"  fault: {fault}")
    _say(f"  replay: {replay_command(case)}")


def _tell(verdict: Verdict) -> None:
    for name, text in verdict.violations.items():
        _say(f"  {name}: {text}")


def _summary(tally: Tally, took_s: float) -> str:
    ended = ", ".join(f"{count} {name}" for name, count in tally.ended.most_common())
    kinds = ", ".join(f"{name} {count}" for name, count in tally.happened.most_common())
    rate = f"{tally.scans} scans in {took_s:.0f} s, {60 * tally.scans / max(took_s, 1e-3):.0f} a minute"
    return f"{rate}\nended: {ended}\nfaults happened in so many scans: {kinds}\nviolations: {len(tally.failures)}"


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())

"""pytest plugin: tests marked `twin` run in a private network namespace, in a child pytest.

Mark a test (or a module: ``pytestmark = pytest.mark.twin``) and write it as any other: use Aravis in the test's own
process, fixtures and parameters included. The first marked test starts a child pytest inside a namespace, which runs one
marked test after the other as it is told; each test's own report comes back and is shown as if it had run here. So tests may
also be shared out among processes (``-n 2``): no two see the same network.

To debug one with --pdb or prints, start pytest itself inside: ``python -m scanhsi_sim.twins.netns python -m pytest ...``.
What is missing (Aravis, permission) skips the tests; where the variable CI is set it fails them.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import IO, Any

import pytest

from scanhsi_sim.twins import netns

REQUIREMENTS = "sudo apt install python3-gi gir1.2-aravis-0.8 libsimavr-dev libelf-dev gcc"
_FDS = (
    "SCANHSI_TEST_FDS"  # set in the child: where it reads which test is next, and writes its reports, as lines of JSON
)


class _Child:
    """The pytest inside the namespace: runs the tests it is told to, and streams their reports."""

    def __init__(self, config: pytest.Config, files: list[str]) -> None:
        asked, ask = os.pipe()
        read_end, write_end = os.pipe()
        self.output: IO[str] = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed with the session)
        self.process = subprocess.Popen(
            [
                *netns.prefix(),
                sys.executable,
                "-m",
                "pytest",
                "-m",
                "",
                "-p",
                "no:cacheprovider",
                "-p",
                "no:hypothesispytest",  # takes two seconds to import
                "--capture=fd",
                *files,
            ],
            cwd=config.rootpath,
            env={**os.environ, _FDS: f"{asked},{write_end}"},
            pass_fds=[asked, write_end],
            stdin=subprocess.DEVNULL,
            stdout=self.output,
            stderr=subprocess.STDOUT,
        )
        os.close(asked)
        os.close(write_end)
        self._ask, self._reports = os.fdopen(ask, "w"), os.fdopen(read_end)

    def run(self, node: str, following: str | None) -> Iterator[dict[str, Any]]:
        """Run one test; its serialized reports, as they come. They end early when the child does."""
        with suppress(BrokenPipeError):
            self._ask.write(json.dumps([node, following]) + "\n")
            self._ask.flush()
        for line in self._reports:
            data = json.loads(line)
            if isinstance(data["longrepr"], list):  # a skip's place and reason: JSON knows no tuples
                data["longrepr"] = tuple(data["longrepr"])
            yield data
            if data["when"] == "teardown":
                return

    def last_words(self) -> str:
        """What the child printed, for when it ended before its tests did."""
        code = self.process.wait(timeout=10)
        self.output.seek(0)
        return f"the pytest in the private network ended with code {code}:\n{self.output.read()[-4000:]}"

    def close(self) -> None:
        """End the child, unless it has ended by itself, and free what it held."""
        with suppress(BrokenPipeError):
            self._ask.close()  # nothing more to run
        try:
            self.process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            self.process.terminate()
        self.process.wait(timeout=10)
        self._reports.close()
        self.output.close()


_child = pytest.StashKey[_Child]()


def _is_twin(item: pytest.Item) -> bool:
    return item.get_closest_marker("twin") is not None


def _runs_elsewhere(item: pytest.Item) -> bool:
    return _is_twin(item) and not netns.in_private_network()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave the time limit of what runs elsewhere to the child, which knows when a test begins."""
    for item in filter(_runs_elsewhere, items):
        item.add_marker(pytest.mark.timeout(0))


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a marked test in the child; anything else as always."""
    if not _runs_elsewhere(item):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in _reports_from_child(item, nextitem):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    # the fixtures of unmarked tests that ran here before, if nobody needs them any more
    item.session._setupstate.teardown_exact(nextitem)  # pyright: ignore[reportPrivateUsage] (no public way)
    return True


def _reports_from_child(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[pytest.TestReport]:
    config = item.config
    if _child not in config.stash:
        files = dict.fromkeys(str(i.path) for i in item.session.items if _runs_elsewhere(i))
        config.stash[_child] = _Child(config, list(files))
    child = config.stash[_child]
    following = nextitem.nodeid if nextitem is not None and _runs_elsewhere(nextitem) else None
    finished = False
    for data in child.run(item.nodeid, following):
        yield config.hook.pytest_report_from_serializable(config=config, data=data)
        finished = data["when"] == "teardown"
    if not finished:  # the next test gets a new child
        text = child.last_words()
        child.close()
        del config.stash[_child]
        location = (str(item.path), 0, text)
        outcome, why = ("failed", text) if "CI" in os.environ or "code 77" not in text else ("skipped", location)
        yield pytest.TestReport(item.nodeid, item.location, {}, outcome, why, "setup")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Name what is missing before a marked test trips over it."""
    missing = _is_twin(item) and _missing()
    if missing:
        (pytest.fail if "CI" in os.environ else pytest.skip)(f"{missing}: {REQUIREMENTS}")


@cache
def _missing() -> str:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
    except (ImportError, ValueError) as error:
        return str(error)
    return "" if shutil.which("gcc") else "no gcc"


class _Server:
    """In the child: runs the tests that the pytest outside asks for, and hands it each report."""

    def __init__(self, config: pytest.Config, asked: int, reports: int) -> None:
        self.config, self.asked, self.reports = config, asked, reports

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Instead of all that was collected."""
        if session.testsfailed:
            return None  # a file cannot be imported: pytest says so and ends
        items = {item.nodeid: item for item in session.items}
        with os.fdopen(self.asked) as lines:
            for node, following in map(json.loads, lines):
                item = items[node]
                item.ihook.pytest_runtest_protocol(item=item, nextitem=items.get(following))
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        data = self.config.hook.pytest_report_to_serializable(config=self.config, report=report)
        os.write(self.reports, json.dumps(data).encode() + b"\n")


def pytest_configure(config: pytest.Config) -> None:
    """Serve the pytest outside, if this is the child."""
    fds = os.environ.pop(_FDS, None)
    if fds is not None:
        config.pluginmanager.register(_Server(config, *map(int, fds.split(","))))


def pytest_unconfigure(config: pytest.Config) -> None:
    """End the child, also when pytest stopped early."""
    if _child in config.stash:
        config.stash[_child].close()

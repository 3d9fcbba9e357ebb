"""Servers that go away in mid-write, and commands that write to a bucket."""

from __future__ import annotations

import asyncio
import json
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.cli import run
from scanhsi.cube.lease import KEY
from scanhsi.cube.location import locate
from scanhsi.cube.object_destination import ObjectDestination
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError
from support.buckets import cube_copy
from support.cubes import feed
from support.seaweed import S3, SECRET, Seaweed
from support.slow_link import slow_link
from support.truth import check_complete, check_truth
from support.victims import MISSING, Job


@dataclass(frozen=True)
class Outage:
    """A server that can be made to go away and come back."""

    s3: S3
    begin: Callable[[], None]
    end: Callable[[], None]


@pytest.fixture
def broken_link(server: S3, monkeypatch: pytest.MonkeyPatch) -> Iterator[Outage]:
    """The server lives on, nobody reaches it."""
    with slow_link(server.endpoint) as link:
        monkeypatch.setenv("AWS_ENDPOINT_URL", link.endpoint)
        yield Outage(server, link.cut, link.mend)


@pytest.fixture
def dying_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Outage]:
    """A server of one's own, killed and started again on its data."""
    with Seaweed(tmp_path / "mortal") as running:
        for name, value in running.s3.environment.items():
            monkeypatch.setenv(name, value)
        yield Outage(running.s3, running.kill, running.start)


async def scan_until(job: Job, retry_s: float, at: int, event: Callable[[], None]) -> None:
    """Write a cube; call ``event`` when so many lines have been appended."""
    records = LineRecords(job.lines)
    writer = CubeWriter(ObjectDestination(locate(job.path), retry_s=retry_s), job.spec, lines_per_shard=6, slots=2)
    await writer.open(records)
    try:
        await feed(writer, job.spec, records, range(at), MISSING)
        event()
        await feed(writer, job.spec, records, range(at, job.lines), MISSING)
        await writer.flush()
    finally:
        await writer.close()


def endure(outage: Outage, url: str, tmp_path: Path) -> None:
    """One outage that is longer than the writer's patience, resumed, and one that is not."""
    job = Job(url)
    with pytest.raises(CubeError, match="no connection to the server.* Try: AWS_ENDPOINT_URL.*resumed") as caught:
        clock.run(scan_until(job, 0.5, 20, outage.begin))
    assert SECRET not in "".join(traceback.format_exception(caught.value))
    outage.end()
    here = cube_copy(outage.s3, url, tmp_path / "copy.zarr")
    assert here is not None
    lines = check_truth(here, job.spec, MISSING)
    assert lines < job.lines
    clock.run(go_on(outage, job, lines))
    here = cube_copy(outage.s3, url, tmp_path / "copy.zarr")
    assert here is not None
    check_complete(here, job.spec, MISSING)


async def go_on(outage: Outage, job: Job, lines: int) -> None:
    records = LineRecords(job.lines)
    writer = CubeWriter.resume(job.path, job.spec)
    assert writer.next_line == lines
    await writer.open(records)
    outage.begin()
    ending = asyncio.get_running_loop().run_in_executor(None, lambda: (time.sleep(0.3), outage.end()))
    try:
        await feed(writer, job.spec, records, range(lines, job.lines), MISSING)
    finally:
        await writer.close()
        await ending


def test_a_link_that_breaks(broken_link: Outage, url: str, tmp_path: Path) -> None:
    endure(broken_link, url, tmp_path)


@pytest.mark.soak
def test_a_server_that_is_killed(dying_server: Outage, tmp_path: Path) -> None:
    endure(dying_server, f"s3://{dying_server.s3.bucket}/a.zarr", tmp_path)


SMALL = ("storage.lines_per_shard=8", "roi.samples=200", "roi.bands=120")
SCAN = [
    "scan",
    "sensors2019",
    "--virtual",
    "--lines",
    "24",
    "--seed",
    "3",
    *(word for key in SMALL for word in ("--set", key)),
]


@pytest.mark.parametrize("spooled", [False, True])
def test_scan_to_a_bucket(
    server: S3, url: str, here: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], spooled: bool
) -> None:
    spool = tmp_path / "spool"
    command = [*SCAN, "-o", url, "--json", *(["--spool", str(spool)] if spooled else [])]
    assert run(command) == 0
    assert json.loads(capsys.readouterr().out)["output"] == url
    assert KEY not in server.contents(url)
    assert run([*SCAN, "-o", str(here)]) == 0
    written, local = scanhsi.open_cube(url), scanhsi.open_cube(here)
    np.testing.assert_array_equal(written["cube"].values, local["cube"].values)
    assert written["cube"].values.any()
    np.testing.assert_array_equal(written["mirror_step"].values, local["mirror_step"].values)
    capsys.readouterr()
    assert run(command) != 0
    assert "exists already; nothing was written" in capsys.readouterr().err
    if not spooled:
        assert run(["info", url]) == 0
        assert run(["view", url, "-o", str(tmp_path / "look.png")]) == 0
        assert run(["export", url, "-o", str(tmp_path / "hand.hdr")]) == 0
    if spooled:
        assert run(["drain", str(spool)]) == 0
        assert "nothing waits" in capsys.readouterr().out


def test_what_is_refused(server: S3, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*SCAN, "--discard", "--spool", str(tmp_path)]) == 2
    assert run([*SCAN, "-o", str(tmp_path / "a.zarr"), "--spool", str(tmp_path / "s")]) != 0
    assert "a spool is for cubes at URLs" in capsys.readouterr().err
    assert run(["drain", str(tmp_path / "not")]) != 0
    assert "there is no spool folder" in capsys.readouterr().err


def test_wrong_credentials_are_not_told(
    url: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", wrong := "wrong-secret-of-mine")
    assert run(["--log-level", "debug", *SCAN, "-o", url]) != 0
    told = capsys.readouterr()
    assert "the server refuses it with these credentials" in told.err
    assert wrong not in told.err + told.out
    assert "Signature" not in told.err

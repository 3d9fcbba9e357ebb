"""An object store as a destination: nothing is overwritten, one writer, errors in our own words."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable

import pytest

from scanhsi.cube import lease as leases
from scanhsi.cube.destination import Destination, DestinationError
from scanhsi.cube.lease import KEY, Lease
from scanhsi.cube.location import locate
from scanhsi.cube.object_destination import ObjectDestination
from scanhsi.cube.objects import Conflict, Objects
from support.seaweed import S3, SECRET

FIRST = {"zarr.json": b"{}", "status/zarr.json": b"{1}", "cube/zarr.json": b"{2}"}


def quick(objects: Objects) -> Lease:
    """A lease that runs out soon."""
    return Lease(objects, ttl_s=1.5, beat_s=0.2)


def another(url: str, lease: Callable[[Objects], Lease] = quick) -> ObjectDestination:
    return ObjectDestination(locate(url), retry_s=2, lease=lease)


def view(data: bytes) -> memoryview:
    return memoryview(data)


def test_it_is_a_destination(destination: ObjectDestination, url: str) -> None:
    cube: Destination = destination
    assert cube.name == url
    cube.create(FIRST)
    assert cube.get("status/zarr.json") == b"{1}"
    cube.put("cube/c/0/1/0", [view(b"abc"), view(b""), view(b"defg")], durable=True)
    cube.put("cube/c/0/1/0", [view(b"again")], durable=True)
    assert cube.get("cube/c/0/1/0") == b"again"
    assert cube.get("cube/c/0/2/0") is None
    cube.put_all({f"time/c/{shard}": bytes([shard]) for shard in range(20)} | {"status/c/0": b"s"}, durable=False)
    cube.settle()
    assert cube.keys("status") == ["status/c/0", "status/zarr.json"]
    assert len(cube.keys("time")) == 20
    assert cube.keys("nothing") == []
    cube.delete(["status/c/0", "status/c/9"])
    assert cube.keys("status") == ["status/zarr.json"]
    cube.put("status/c/0", [view(b"new")], durable=True)
    assert cube.free_bytes() is None
    cube.unlock()
    cube.unlock()
    assert Objects(locate(url)).get(KEY) is None


def test_a_big_object_is_one_request(destination: ObjectDestination) -> None:
    destination.create(FIRST)
    parts = [os.urandom(7_000_000), os.urandom(5_000_001)]
    destination.put("cube/c/0/0/0", [view(part) for part in parts], durable=True)
    assert destination.get("cube/c/0/0/0") == b"".join(parts)


@pytest.mark.parametrize("key", ["zarr.json", "README.txt", "cube/c/0/0/0"])
def test_nothing_that_is_there_is_overwritten(server: S3, url: str, destination: ObjectDestination, key: str) -> None:
    Objects(locate(url)).put(key, [b"somebody else's"], None)
    with pytest.raises(FileExistsError):
        destination.create(FIRST)
    assert server.contents(url) == {key: b"somebody else's"}


def test_somebody_is_faster(server: S3, url: str, destination: ObjectDestination) -> None:
    """The root appears between the look and the write: whoever was first keeps it, and nothing is left of the other."""
    clear = destination._clear

    def clear_and_be_slow(left: list[str]) -> None:
        clear(left)
        Objects(locate(url)).put("zarr.json", [b"theirs"], None)

    destination._clear = clear_and_be_slow  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(FileExistsError):
        destination.create(FIRST)
    assert server.contents(url) == {"zarr.json": b"theirs"}


def test_a_second_writer_is_refused(destination: ObjectDestination, url: str) -> None:
    destination.create(FIRST)
    with pytest.raises(FileExistsError):
        another(url).create(FIRST)
    with pytest.raises(BlockingIOError, match="is writing it"):
        another(url, lambda objects: Lease(objects, beat_s=20)).lock()
    destination.put("status/c/0", [view(b"mine")], durable=True)
    destination.unlock()
    second = another(url)
    second.lock()
    second.put("status/c/0", [view(b"theirs")], durable=True)
    second.unlock()
    assert second.get("status/c/0") == b"theirs"


def test_locking_nothing(destination: ObjectDestination) -> None:
    with pytest.raises(FileNotFoundError):
        destination.lock()


KILLED = """
import os, signal, sys
from scanhsi.cube.location import locate
from scanhsi.cube.object_destination import ObjectDestination
cube = ObjectDestination(locate(sys.argv[1]))
if sys.argv[2] == "creating":
    cube._create = lambda files: (
        cube._objects.put("status/zarr.json", [b"half"], None),
        os.kill(os.getpid(), signal.SIGKILL),
    )
cube.create({"zarr.json": b"{}", "status/zarr.json": b"{1}", "cube/zarr.json": b"{2}"})
os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_writer(url: str, moment: str) -> None:
    assert subprocess.run([sys.executable, "-c", KILLED, url, moment]).returncode == -9


def test_a_killed_writer_of_this_computer_keeps_nobody_out(server: S3, url: str) -> None:
    kill_writer(url, "writing")
    assert KEY in server.contents(url)
    second = another(url, Lease)  # a minute's patience; the test's is shorter
    with pytest.raises(FileExistsError):
        second.create(FIRST)
    second.lock()
    second.unlock()


def test_a_creator_that_was_killed_leaves_no_cube_in_the_way(
    server: S3, url: str, destination: ObjectDestination
) -> None:
    kill_writer(url, "creating")
    assert server.contents(url)["status/zarr.json"] == b"half"
    with pytest.raises(FileNotFoundError):
        destination.lock()
    destination.create(FIRST)
    destination.unlock()
    assert server.contents(url) == FIRST


def test_but_files_of_others_that_came_meanwhile_are(server: S3, url: str, destination: ObjectDestination) -> None:
    kill_writer(url, "creating")
    Objects(locate(url)).put("README.txt", [b"somebody else's"], None)
    with pytest.raises(FileExistsError):
        destination.create(FIRST)
    assert server.contents(url)["README.txt"] == b"somebody else's"


def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on this process seems to run on another computer."""
    real = leases._system
    monkeypatch.setattr(leases, "_system", lambda: {**real(), "boot": "another"})


def test_a_writer_killed_elsewhere_has_its_time(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kill_writer(url, "writing")
    elsewhere(monkeypatch)
    polls: list[str] = []
    second = another(url)
    get = second._objects.get
    second._objects.get = lambda key: (polls.append(key), get(key))[1]  # pyright: ignore[reportAttributeAccessIssue]
    second.lock()
    assert len(polls) > 10  # it watched for all of its patience
    second.unlock()


def test_one_that_was_not_heard_of_stops_when_another_has_taken_over(
    url: str, destination: ObjectDestination, monkeypatch: pytest.MonkeyPatch
) -> None:
    destination.lease = quick(destination._objects)
    destination.create(FIRST)
    destination.lease._stop.set()  # no beats: the process hangs
    elsewhere(monkeypatch)
    second = another(url)
    second.lock()
    second.put("status/c/0", [view(b"theirs")], durable=True)
    with pytest.raises(DestinationError, match="another writer took the cube over"):
        destination.put("status/c/0", [view(b"mine")], durable=True)
    with pytest.raises(DestinationError, match="took the cube over"):
        destination.delete(["status/c/0"])
    destination.unlock()
    assert second.get("status/c/0") == b"theirs"
    assert second.lease.held
    second.put("status/c/0", [view(b"more")], durable=True)
    second.unlock()


def test_what_was_sent_long_ago_and_arrives_late_overwrites_nothing(
    url: str, destination: ObjectDestination, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lease was looked at before, the request takes its time."""
    destination.create(FIRST)
    destination.put("status/c/0", [view(b"mine")], durable=True)
    destination.lease._stop.set()
    monkeypatch.setattr(destination.lease, "check", lambda: None)
    leases._HELD.clear()  # as if this process were another one
    second = another(url)
    second.lock()
    for key in ("status/c/0", "cube/c/0/0/0"):
        second.put(key, [view(b"theirs")], durable=True)
        with pytest.raises(DestinationError, match=f"{key} was written by another program") as caught:
            destination.put(key, [view(b"late")], durable=True)
        assert caught.value.errno == errno.EBUSY
        assert second.get(key) == b"theirs"
    second.unlock()


def test_a_lost_answer_is_no_conflict(url: str) -> None:
    objects = Objects(locate(url))
    version = objects.put("a", [b"12", b"3"], None)
    assert objects.put("a", [b"123"], None) == version  # sent again, since no answer came
    with pytest.raises(Conflict):
        objects.put("a", [b"124"], None)
    with pytest.raises(Conflict):
        objects.put("a", [b"124"], {"e_tag": '"1"'})
    assert objects.get("a") == (b"123", version)


def test_a_server_without_conditions_is_refused(
    destination: ObjectDestination, monkeypatch: pytest.MonkeyPatch
) -> None:
    import obstore

    put = obstore.put

    def put_anyway(*args: object, **options: object) -> object:
        return put(*args, **{**options, "mode": "overwrite"})  # pyright: ignore

    monkeypatch.setattr(obstore, "put", put_anyway)
    with pytest.raises(DestinationError, match="ignores conditions"):
        destination.create(FIRST)
    assert destination.keys("") == []


def test_refused(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", wrong := "wrong-secret-of-mine")
    with pytest.raises(DestinationError, match="refuses it with these credentials") as caught:
        another(url).create(FIRST)
    told = "".join(traceback.format_exception(caught.value))
    assert caught.value.errno == errno.EACCES
    assert wrong not in told
    assert "Signature" not in told


def test_no_server(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(DestinationError, match=r"no connection to the server, tried for \d s") as caught:
        another(url).create(FIRST)
    assert SECRET not in "".join(traceback.format_exception(caught.value))


def test_what_a_lease_tells(server: S3, url: str, destination: ObjectDestination) -> None:
    destination.create(FIRST)
    lease = json.loads(server.contents(url)[KEY])
    assert lease["process"]["pid"] == os.getpid()
    assert lease["creating"] is None
    assert SECRET not in str(lease)

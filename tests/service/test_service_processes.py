"""The server as a process: killed in the middle of a scan, and shown to viewers of which one never listens."""

from __future__ import annotations

import ast
import asyncio
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import aclosing
from pathlib import Path

import httpx
import pytest

import scanhsi
from scanhsi.client import connect_instrument
from scanhsi.clock import run_virtual
from scanhsi.cube.reader import cube_summary
from scanhsi.cube.verify import verify_cube
from scanhsi.instrument import load_instrument
from support.server import SMALL, Server, serving

LINES = 100_000
ROOT = Path(__file__).parents[2]


def begin(server: Server) -> None:
    """Start a scan, and wait until some lines are safe."""
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=30) as http:
        lease = {"Scanhsi-Lease": http.post("/lease", json={"name": "Ada"}).json()["id"]}
        body = {"plan": {"lines": LINES, "exposure_s": 0.01, "step": 0}, "output": "a"}
        job = http.post("/scans", json=body, headers=lease).json()
        while ((http.get(f"/jobs/{job['id']}").json()["progress"]) or {"stored": 0})["stored"] < 8:
            time.sleep(0.1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_server_leaves_a_valid_cube(number: signal.Signals, tmp_path: Path) -> None:
    with serving(tmp_path) as server:
        begin(server)
        code = server.end(number)
    assert code == (-signal.SIGKILL if number == signal.SIGKILL else 0), "".join(server.said)
    verified = verify_cube(tmp_path / "a.zarr")
    assert verified.intact
    assert 8 <= verified.lines_stored < LINES
    assert cube_summary(tmp_path / "a.zarr").simulated is True
    if number != signal.SIGKILL:
        assert not verified.untidy
        assert not any("Traceback" in line for line in server.said), "".join(server.said)


TOKEN = "a token that is long enough"


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Generator[tuple[Server, Path]]:
    """A server with a token, and its log."""
    folder = tmp_path_factory.mktemp("locked")
    arguments = ("--seed", "7", "--log-level", "debug", "--log-file", str(folder / "log"))
    with serving(folder / "data", token=TOKEN, arguments=arguments) as server:
        yield server, folder / "log"


def test_a_remote_scan_is_the_local_one_bit_for_bit(locked: tuple[Server, Path], tmp_path: Path) -> None:
    """Over real sockets and in real time, against virtual time here: noise and light come from the seed, not from the clock."""
    config = load_instrument("sensors2019", dict(setting.split("=") for setting in SMALL)).with_seed(7)

    async def script() -> None:
        async with scanhsi.open_instrument(config) as hsi:
            await hsi.scan(hsi.default_plan(lines=30), tmp_path / "local.zarr")

    async def remote(url: str) -> None:
        async with (
            connect_instrument(url, token=TOKEN) as hsi,
            aclosing(hsi.preview()) as preview,
            aclosing(hsi.events()) as events,
        ):
            assert (await anext(events)).type == "hello"
            seen = asyncio.ensure_future(anext(preview))
            await hsi.scan(hsi.default_plan(lines=30), tmp_path / "remote.zarr")
            assert (await seen).kind in ("frame", "rows")

    run_virtual(script())
    asyncio.run(remote(locked[0].url))
    here, there = (scanhsi.open_cube(tmp_path / name, chunks=None) for name in ("local.zarr", "remote.zarr"))
    assert (here["cube"].values == there["cube"].values).all()
    assert (here["mirror_step"].values == there["mirror_step"].values).all()


def test_a_viewer_that_never_listens_costs_nothing_but_its_socket(locked: tuple[Server, Path]) -> None:
    """Its connection is full after some frames; the scan goes on, and so do the others."""
    address = httpx.URL(locked[0].url)
    deaf = socket.create_connection((address.host, address.port or 80))
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.sendall(
        f"GET /api/v1/preview HTTP/1.1\r\nHost: {address.host}:{address.port}\r\nUpgrade: websocket\r\n"
        f"Authorization: Bearer {TOKEN}\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )

    async def others() -> None:
        async with connect_instrument(locked[0].url, token=TOKEN, download=False) as hsi:
            report = await hsi.scan(hsi.default_plan(lines=100), "a.zarr")
            assert (report.stored, report.missing) == (100, 0)

    asyncio.run(others())
    assert b"101 Switching Protocols" in deaf.recv(200)
    deaf.close()


def test_the_notebook_runs(locked: tuple[Server, Path], tmp_path: Path) -> None:
    """In a kernel of Jupyter's; its figure is there."""
    notebook = Path(shutil.copy(ROOT / "docs" / "examples" / "remote.ipynb", tmp_path))
    variables = {"SCANHSI_URL": locked[0].url, "SCANHSI_TOKEN": TOKEN, "JUPYTER_PLATFORM_DIRS": "1"}
    execute = "from nbclient.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", execute, "--inplace", "--timeout=60", "--KernelManager.transport=ipc", notebook.name],
        cwd=tmp_path,
        env={**os.environ, **variables, "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert TOKEN not in notebook.read_text()
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    told = [out for cell in cells for out in cell["outputs"]]
    assert [out["name"] for out in told if out["output_type"] == "stream"] == [], (
        "nothing is said that nobody asked for"
    )
    stored, efficiency, lines_per_second = ast.literal_eval("".join(cells[2]["outputs"][0]["data"]["text/plain"]))
    assert stored == 40
    assert 0 < efficiency < 1 < lines_per_second
    assert "image/png" in cells[3]["outputs"][0]["data"]
    assert (tmp_path / "notebook.zarr").is_dir()


def test_the_token_is_in_no_log(locked: tuple[Server, Path]) -> None:
    server, log = locked
    for headers in ({"Authorization": f"Bearer {TOKEN}"}, {"Authorization": "Bearer wrong-token-guess"}):
        httpx.get(f"{server.url}/api/v1/state", headers=headers)
        httpx.post(f"{server.url}/api/v1/mirror/home", headers=headers)
    text = log.read_text() + "".join(server.said)
    assert "wrong-token-guess" not in text
    assert TOKEN not in text
    assert [json.loads(line) for line in log.read_text().splitlines()]


def test_a_host_that_others_reach_needs_a_token(tmp_path: Path) -> None:
    from scanhsi.cli import run

    assert run(["serve", "--host", "0.0.0.0", "--data", str(tmp_path)]) == 2
    short = tmp_path / "token"
    short.write_text("short")
    assert run(["serve", "--token-file", str(short), "--data", str(tmp_path)]) == 2

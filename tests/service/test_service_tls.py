"""The service behind a certificate of its own: who trusts it gets everything, who does not is told what to do."""

from __future__ import annotations

import asyncio
import subprocess
from contextlib import aclosing
from pathlib import Path

import pytest

from scanhsi import clock
from scanhsi.client import connect_instrument
from scanhsi.devices.errors import ConfigError, DeviceLost, DeviceNotFound
from scanhsi.instrument import load_instrument
from scanhsi.service.server import Serving, serve
from support.server import serving

TOKEN = "a token of the laboratory"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With ``cert.pem`` and ``key.pem``, made as the documentation says."""
    made = tmp_path_factory.mktemp("tls")
    command = (
        "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext subjectAltName=DNS:localhost"
    )
    subprocess.run(
        [*command.split(), "-keyout", "key.pem", "-out", "cert.pem"], cwd=made, check=True, capture_output=True
    )
    return made


def test_a_scan_behind_tls(folder: Path, tmp_path: Path) -> None:
    async def main(url: str) -> int:
        async with connect_instrument(url, token=TOKEN, certificate=folder / "cert.pem") as hsi:
            async with aclosing(hsi.events()) as events, asyncio.timeout(20):
                assert (await anext(events)).type == "hello"
            report = await hsi.scan(hsi.default_plan(lines=3, exposure="10 ms"), tmp_path / "cube.zarr")
            return report.stored

    files = ("--certificate", str(folder / "cert.pem"), "--key", str(folder / "key.pem"))
    with serving(tmp_path / "data", token=TOKEN, arguments=files) as server:
        assert server.url.startswith("https://127.0.0.1:")
        named = server.url.replace("127.0.0.1", "localhost")
        assert clock.run(main(named)) == 3
        with pytest.raises(DeviceNotFound, match="TLS certificate is not trusted") as refused:
            clock.run(main_without(named))
        assert "certificate='cert.pem'" in str(refused.value)
        with pytest.raises(DeviceLost, match="connection broke"):
            clock.run(main_without(named.replace("https", "http")))
        assert server.end() == 0
        assert TOKEN not in "".join(server.said)


async def main_without(url: str) -> None:
    async with connect_instrument(url, token=TOKEN):
        pass


@pytest.mark.parametrize("swapped", [False, True])
def test_a_certificate_that_cannot_be_used_is_refused_before_anything_is_opened(
    folder: Path, tmp_path: Path, swapped: bool
) -> None:
    certificate, key = (folder / "key.pem", folder / "cert.pem") if swapped else (tmp_path / "not", folder / "key.pem")
    with pytest.raises(ConfigError, match="cannot be used"):
        clock.run(
            serve(
                load_instrument("sensors2019"), tmp_path / "data", Serving(certificate=certificate, key=key), told=print
            )
        )
    assert not (tmp_path / "data").exists()


def test_a_client_is_told_of_a_certificate_that_cannot_be_read(tmp_path: Path) -> None:
    async def main() -> None:
        async with connect_instrument("https://localhost:1", certificate=tmp_path / "not.pem"):
            pass

    with pytest.raises(ConfigError, match=r"not\.pem cannot be read: No such file"):
        clock.run(main())

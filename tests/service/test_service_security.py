"""What is refused: other sites, wrong tokens, long bodies, floods, paths that lead out."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx
import pytest

from scanhsi.service.downloads import download
from scanhsi.service.refusals import NoSuch
from scanhsi.service.security import MOST_SOCKETS, Buckets, Security
from support.service import Service, with_service

TOKEN = "correct horse battery staple"
LOCKED = Security(TOKEN, frozenset({"lab-pc"}), requests_s=1e6, burst=1e6, failures_s=0.01)


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def test_the_token_is_asked_for_everywhere(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        http = service.http
        for answer in (
            await http.get("/state"),
            await http.get("/state", headers=bearer("wrong")),
            await http.get(f"/state?token={TOKEN}"),
            await http.get("/openapi.json"),
            await http.post("/stop"),
        ):
            assert (answer.status_code, answer.headers["content-type"]) == (401, "application/problem+json")
            assert answer.headers["www-authenticate"] == "Bearer"
        assert (await http.get("/state", headers=bearer(TOKEN))).status_code == 200
        assert (await http.get("http://localhost/")).status_code == 200  # the page, which asks for it

    with_service(tmp_path, use, security=LOCKED, virtual=False)


def test_guessing_is_slow(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        answers = [(await service.http.get("/state", headers=bearer(f"guess{n}"))).status_code for n in range(20)]
        assert answers[:9] == [401] * 9
        assert answers[-1] == 429

    with_service(tmp_path, use, security=LOCKED)


def test_a_socket_shows_its_token_first(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        async with service.socket("/events", bearer(TOKEN)) as socket:
            assert (await socket.json())["type"] == "hello"
        async with service.socket("/events") as socket:
            socket.send(f'{{"token": "{TOKEN}"}}')
            assert (await socket.json())["type"] == "hello"
        async with service.socket("/events", bearer("wrong")) as socket:
            refused = await socket.message()
            assert (refused["type"], refused["status"]) == ("websocket.http.response.start", 401)
        for said in ('{"token": "wrong"}', "[]", "no json", None):
            async with service.socket("/preview") as socket:
                if said is not None:
                    socket.send(said)
                assert (await socket.message())["type"] == "websocket.accept"
                closed = await socket.message()
                assert (closed["type"], closed["code"]) == ("websocket.close", 1008)

    with_service(tmp_path, use, security=LOCKED)


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:9999"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Host": "evil.example"},
        {"Host": ""},
    ],
)
def test_other_sites_cannot_command(headers: dict[str, str], tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        answer = await service.http.post("/stop", headers=headers)
        assert (answer.status_code, answer.json()["error"]) == (403, "CrossSite")
        async with service.socket("/events", headers) as socket:
            assert (await socket.message())["status"] == 403

    with_service(tmp_path, use)


def test_the_page_itself_can(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        for host in ("localhost:8080", "127.0.0.1:8080", "[::1]:8080", "lab-pc"):
            own = {"Host": host, "Origin": f"http://{host}", "Sec-Fetch-Site": "same-origin", **bearer(TOKEN)}
            assert (await service.http.post("/stop", headers=own)).status_code == 200

    with_service(tmp_path, use, security=LOCKED)


def test_long_bodies_are_refused(tmp_path: Path) -> None:
    async def pieces() -> object:
        for _ in range(100):
            yield b" " * 100_000

    async def use(service: Service) -> None:
        http = service.http
        assert (await http.post("/lease", content=b" " * 2_000_000)).status_code == 413
        assert (await http.post("/lease", content=pieces())).status_code == 413  # pyright: ignore[reportArgumentType]
        assert (await http.post("/lease", content=b"{}", headers={"Content-Length": "-3"})).status_code == 413
        deep = b'{"name":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
        assert (await http.post("/lease", content=deep)).status_code == 422
        assert (await http.post("/lease", json={"name": "x" * 500_000})).status_code == 422

    with_service(tmp_path, use)


@pytest.mark.parametrize(
    "name",
    ["..", "../secret.zarr", "..%2fsecret.zarr", "%2e%2e", "a/../../secret.zarr", "link.zarr", ".hidden", "x" * 300],
)
def test_paths_cannot_leave_the_folder(name: str, tmp_path: Path) -> None:
    data, secret = tmp_path / "data", tmp_path / "secret.zarr"
    data.mkdir()
    secret.mkdir()
    (secret / "zarr.json").write_text("{}")
    (data / "link.zarr").symlink_to(secret)

    async def use(service: Service) -> None:
        for what in ("", "/colour", "/download"):
            answer = await service.http.get(f"/cubes/{name}{what}")
            assert answer.status_code in (404, 405, 422), answer.text
        await service.take_control()
        answer = await service.http.post("/scans", json={"output": name})
        assert answer.status_code in (409, 422), answer.text
        if name != "link.zarr":
            answer = await service.http.post("/calibrations", json={"output": name, "kind": "dark"})
            assert answer.status_code in (409, 422), answer.text
        assert (await service.http.get("/cubes")).json() == []
        page = await service.http.get(f"http://localhost/{name}/zarr.json")
        assert page.status_code == 404

    with_service(data, use, virtual=False)
    assert [path.name for path in secret.iterdir()] == ["zarr.json"]
    assert not (tmp_path / "secret").exists()


def test_links_inside_a_cube_are_not_followed(tmp_path: Path) -> None:
    cube = tmp_path / "a.zarr"
    cube.mkdir()
    (tmp_path / "secret").write_text("secret")
    (cube / "zarr.json").write_text("{}")
    (cube / "c").symlink_to(tmp_path / "secret")
    assert b"secret" not in b"".join(download(cube, "zarr").blocks)


def test_floods_are_refused(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        answers = [(await service.http.get("/lease")).status_code for _ in range(40)]
        assert answers[:20] == [200] * 20
        assert answers[-1] == 429

    with_service(tmp_path, use, security=Security(requests_s=1e-3, burst=25))


def test_a_socket_that_talks_is_closed(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        async with service.socket("/events") as socket:
            for _ in range(100):
                socket.send("x" * 1000)
            while (message := await socket.message())["type"] != "websocket.close":
                pass
            assert message["code"] == 1008
        async with service.socket("/preview") as socket:
            socket.send("x" * 100_000)
            while (message := await socket.message())["type"] != "websocket.close":
                pass

    with_service(tmp_path, use)


def test_so_many_sockets_and_no_more(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        sockets = [service.socket("/events") for _ in range(MOST_SOCKETS + 1)]
        for socket in sockets:
            await socket.__aenter__()
        assert (await sockets[0].json())["type"] == "hello"
        assert (await sockets[-1].message())["status"] == 429
        for socket in sockets:
            await socket.__aexit__()
        async with service.socket("/events") as socket:
            assert (await socket.json())["type"] == "hello"

    with_service(tmp_path, use)


def test_a_stalled_viewer_is_dropped_from_and_told(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        async with service.socket("/events") as socket:
            assert (await socket.json())["type"] == "hello"
            socket.stalled = asyncio.Event()
            for number in range(1000):
                service.station.events.publish("log", {"number": number})
                await asyncio.sleep(0)
            socket.stalled.set()
            told = [await socket.json() for _ in range(200)]
            assert sum(event["dropped"] for event in told) > 500
            assert [event["seq"] for event in told] == sorted(event["seq"] for event in told)

    with_service(tmp_path, use)


def test_buckets_forget_addresses() -> None:
    buckets = Buckets(1.0, 2)
    assert [buckets.take("a", 0) for _ in range(3)] == [True, True, False]
    assert buckets.take("a", 1.5)
    for number in range(5000):
        buckets.take(str(number), 2)
    assert len(buckets._levels) <= 1024


def test_an_unknown_ticket_opens_nothing(tmp_path: Path) -> None:
    async def use(service: Service) -> None:
        with pytest.raises(NoSuch):
            service.station.tickets.use("x")
        answer: httpx.Response = await service.http.get("/downloads/x")
        assert answer.status_code == 404

    with_service(tmp_path, use, security=LOCKED)

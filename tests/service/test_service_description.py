"""The OpenAPI description: committed, whole, and kept to whatever is sent."""

from __future__ import annotations

import json
import threading
from collections.abc import Generator
from pathlib import Path
from typing import Any

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from scanhsi.service.app import description
from support.server import Server, serving

COMMITTED = Path(__file__).parents[2] / "docs" / "reference" / "openapi.json"
CHECKS = (not_a_server_error, content_type_conformance, response_schema_conformance, status_code_conformance)


def essence(value: Any) -> Any:
    """Without what versions of libraries word differently."""
    if isinstance(value, dict):
        return {key: essence(item) for key, item in value.items() if key not in ("title", "version")}
    return [essence(item) for item in value] if isinstance(value, list) else value


def test_the_committed_description_is_the_applications() -> None:
    committed = json.loads(COMMITTED.read_text())
    assert essence(committed) == essence(description()), "python -m scanhsi.service > docs/reference/openapi.json"


def test_clients_can_be_generated() -> None:
    told = description()
    operations = [operation for path in told["paths"].values() for operation in path.values()]
    ids = [operation["operationId"] for operation in operations]
    assert len(set(ids)) == len(ids)
    tags = {tag["name"] for tag in told["tags"]}
    for operation in operations:
        assert operation["tags"][0] in tags
        assert operation["summary"]
        assert operation["description"]
        refused = operation["responses"]["422"]["content"]["application/problem+json"]["schema"]
        assert refused == {"$ref": "#/components/schemas/Problem"}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server]:
    with serving(tmp_path_factory.mktemp("fuzzed")) as server:
        yield server


@pytest.fixture
def control(server: Server) -> Generator[dict[str, str]]:
    """The lease, kept; and somebody who presses STOP again and again, so that no scan lasts."""
    over = threading.Event()
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=60) as http:
        lease = http.post("/lease", json={"name": "fuzz", "ttl_s": 600}).json()["id"]

        def stop() -> None:
            while not over.wait(0.3):
                http.post("/stop")

        stopping = threading.Thread(target=stop)
        stopping.start()
        yield {"Scanhsi-Lease": lease}
        over.set()
        stopping.join()
        http.delete("/lease", headers={"Scanhsi-Lease": lease})


def fuzz(server: Server, headers: dict[str, str], examples: int) -> list[str]:
    schema = schemathesis.openapi.from_dict(description())
    tried: list[str] = []
    failures: list[Exception] = []
    for found in schema.get_all_operations():
        operation = found.ok()
        if operation.path == "/api/v1/lease" and operation.method in ("post", "delete"):
            continue  # the lease is needed
        tried.append(operation.label)

        @settings(
            max_examples=examples,
            derandomize=True,
            deadline=None,
            phases=[Phase.explicit, Phase.generate],
            suppress_health_check=list(HealthCheck),
            database=None,
        )
        @given(case=operation.as_strategy())
        def try_it(case: schemathesis.Case) -> None:
            if "wait_s" in (case.query or {}):
                del case.query["wait_s"]
            case.headers = {key: value for key, value in (case.headers or {}).items() if key != "Idempotency-Key"}
            answer = case.call(base_url=server.url, headers=headers)
            case.validate_response(answer, checks=list(CHECKS))

        try:
            try_it()
        except Exception as error:
            failures.append(error)
    if failures:
        raise ExceptionGroup("what was sent and should not have been answered so", failures)
    return tried


def test_nothing_that_is_described_answers_5xx(server: Server, control: dict[str, str]) -> None:
    tried = fuzz(server, control, 2)
    assert len(tried) > 40
    assert server.process.poll() is None
    assert not any("Traceback" in line for line in server.said), "".join(server.said)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_nothing_answers_5xx_soak(server: Server, control: dict[str, str]) -> None:
    fuzz(server, control, 150)
    assert server.process.poll() is None
    assert not any("Traceback" in line for line in server.said), "".join(server.said)

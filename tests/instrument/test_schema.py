"""The JSON schema: what an editor or another program may rely on."""

import re
from typing import Any

import pytest

from scanhsi.instrument.load import template
from scanhsi.instrument.schema import schema

pytestmark = pytest.mark.usefixtures("spares")


def device(role: str) -> list[dict[str, Any]]:
    whole = schema()
    reference = whole["properties"][role]["$ref"].rsplit("/", 1)[1]
    return whole["$defs"][reference]["oneOf"]


def test_a_table_is_one_of_the_installed_drivers() -> None:
    assert [table["properties"]["driver"]["const"] for table in device("camera")] == [
        "spare",
        "wired",
    ]  # broken is left out
    spare = device("camera")[0]
    assert spare["additionalProperties"] is False
    assert spare["properties"]["settle"]["type"] == "string"
    assert spare["required"] == ["driver"]
    assert device("camera")[1]["required"] == ["driver", "address"]


def test_what_may_be_left_out() -> None:
    assert sorted(schema()["required"]) == ["actuator", "camera", "geometry"]


def test_nothing_that_toml_cannot_say() -> None:
    def check(node: Any) -> None:
        if isinstance(node, dict):
            assert node.get("type") != "null"
            assert node.get("default", "") is not None
            for value in node.values():
                check(value)
        elif isinstance(node, list):
            for value in node:
                check(value)

    check(schema())


def test_quantities_are_strings_with_examples() -> None:
    geometry = schema()["$defs"]["Geometry"]["properties"]
    assert geometry["distance"]["type"] == "string"
    assert "348.73 mm" in geometry["distance"]["examples"]
    assert geometry["normal_step"]["type"] == "integer"


def test_every_key_is_explained() -> None:
    whole = schema()
    tables = [
        whole,
        *(whole["$defs"][name] for name in ("Geometry", "Spectral", "RoiConfig", "Limits", "Storage", "ScanDefaults")),
    ]
    unexplained = [
        key
        for table in tables
        for key, body in table["properties"].items()
        if "description" not in body and "$ref" not in body and "allOf" not in body
    ]
    assert not unexplained


def test_the_template_mentions_every_key() -> None:
    whole = schema()
    text = template()
    for table, definition in (
        ("geometry", "Geometry"),
        ("spectral", "Spectral"),
        ("roi", "RoiConfig"),
        ("limits", "Limits"),
        ("storage", "Storage"),
        ("scan", "ScanDefaults"),
    ):
        section = re.split(rf"(?m)^(?:# )?\[{table}\]$", text)[1].split("\n# ---", 1)[0]
        for key in whole["$defs"][definition]["properties"]:
            assert f"{key} = " in section, (table, key)

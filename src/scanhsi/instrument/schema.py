"""The JSON schema of an instrument file, with the options of the drivers installed here."""

from __future__ import annotations

from typing import Any, Final, cast

from scanhsi.devices import Found, Role, installed
from scanhsi.instrument.config import InstrumentConfig

_DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]


def schema() -> Schema:
    """JSON schema (2020-12) of an instrument file as TOML holds it; each device table is one of the installed drivers."""
    whole: Schema = InstrumentConfig.model_json_schema(by_alias=True)
    definitions = cast("Schema", whole.setdefault("$defs", {}))
    for role, table in ((Role.CAMERA, "CameraConfig"), (Role.ACTUATOR, "ActuatorConfig"), (Role.LIGHT, "LightConfig")):
        definitions[table] = _device(role, definitions)
    whole["required"] = [key for key in whole["required"] if key != "name"]  # a file without one is named after itself
    whole["title"] = "scanhsi instrument"
    return {"$schema": _DIALECT, **cast("Schema", _written(whole))}


def _device(role: Role, definitions: Schema) -> Schema:
    usable = [found for found in installed(role) if found.backend is not None]
    return {
        "title": f"{role.word} driver and its options",
        "oneOf": [_driver(found, definitions) for found in usable],
        "discriminator": {"propertyName": "driver"},
    }


def _driver(found: Found, definitions: Schema) -> Schema:
    """The table of one driver. Its own definitions get its name in front, for two drivers may use the same ones."""
    assert found.backend is not None
    prefix = f"{found.role.word}-{found.name}-"
    options: Schema = found.backend.options.model_json_schema(by_alias=True, ref_template=f"#/$defs/{prefix}{{model}}")
    definitions.update({f"{prefix}{name}": body for name, body in options.pop("$defs", {}).items()})
    name = {"const": found.name, "description": found.backend.summary}
    return {
        **options,
        "title": f'driver = "{found.name}"',
        "properties": {"driver": name, **options.get("properties", {})},
        "required": ["driver", *options.get("required", [])],
    }


def _written(node: Any) -> Any:
    """Leave out what a TOML file cannot say: null, and defaults in another form than the one that is written."""
    if isinstance(node, list):
        return [_written(item) for item in cast("list[Any]", node)]
    if not isinstance(node, dict):
        return node
    table = {key: _written(value) for key, value in cast("Schema", node).items()}
    choices = table.get("anyOf")
    if isinstance(choices, list) and {"type": "null"} in choices:
        kept = [choice for choice in cast("list[Any]", choices) if choice != {"type": "null"}]
        rest = {key: value for key, value in table.items() if key != "anyOf"}
        table = {**kept[0], **rest} if len(kept) == 1 else {**rest, "anyOf": kept}
    if table.get("default", ...) is None or (
        table.get("type") == "string" and not isinstance(table.get("default"), str)
    ):
        table.pop("default", None)
    return table

"""The profile format as JSON Schema, for editors that complete and check TOML."""

# The schema follows draft 7, because the TOML plug-ins of editors read that (taplo, Even Better
# TOML). msgspec makes a schema from the classes of model.py. This module replaces its references by
# what they refer to, because draft 7 ignores a description beside a `$ref`.
#
# The schema describes one file. Rules between keys or files (areas that overlap, points outside
# their area, `extends`) are checked when a profile is loaded. The schema accepts one spelling where
# loading accepts several: 28bits for a silence, 3 or 0x0E30 for a number as a key.

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from mbtool.devices.model import Profile
from mbtool.devices.point_types import PointType

_EXTENDS = (
    "A built-in profile's name, or the path of a file relative to this one. This file then has "
    "only what differs."
)
_FUNCTION_CODE = "^(0[1-9A-Fa-f]|[1-7][0-9A-Fa-f])$"
_NUMBER_AS_KEY = "^-?(0x[0-9A-Fa-f]+|0|[1-9][0-9]*)$"
_PATTERNS = {
    "name": "^[A-Za-z0-9][A-Za-z0-9._-]*$",
    "silence": r"^[0-9]{1,6}(\.[0-9]{1,3})? ?(bits|chars|ms|us)$",
}


def profile_schema() -> dict[str, Any]:
    """The JSON Schema (draft 7) of a profile file, as a dictionary."""
    parts = msgspec.json.schema(Profile)["$defs"]
    schema = _part("Profile", parts)
    properties = schema["properties"]
    required = schema.pop("required")
    properties["name"]["pattern"] = _PATTERNS["name"]
    properties["transports"]["minItems"] = 1
    for silence in properties["timing"]["properties"].values():
        silence["pattern"] = _PATTERNS["silence"]
    functions = properties["functions"]
    functions["patternProperties"] = {_FUNCTION_CODE: functions["additionalProperties"]}
    functions["additionalProperties"] = False
    properties["points"]["items"]["properties"]["stride"].pop("default", None)
    properties["points"]["items"]["allOf"] = [
        _demand(PointType.STRING, "length"),
        _demand(PointType.FLAGS, "bits"),
    ]
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        **schema,
        "title": "mbtool device profile",
        "properties": {"extends": {"type": "string", "description": _EXTENDS}, **properties},
        "if": {"not": {"required": ["extends"]}},
        "then": {"required": required},
    }


def description(part: type[msgspec.Struct], key: str) -> str:
    """The description of a key in one part of a profile, such as the key `scale` of a Point."""
    keys = msgspec.json.schema(part)["$defs"][part.__name__]["properties"]
    return str(keys[key]["description"])


def _demand(type_: PointType, key: str) -> dict[str, Any]:
    """Return the part of the JSON Schema that says that a point of the type `type_` must have the
    key `key`.
    """
    return {
        "if": {"properties": {"type": {"const": type_.value}}, "required": ["type"]},
        "then": {"required": [key]},
    }


def _inlined(node: Mapping[str, Any], parts: dict[str, Any]) -> dict[str, Any]:
    """Return the schema `node` with each `$ref` replaced by the part that it refers to.

    `parts` has the schemas of all parts by name. The type null is left out, because TOML lacks it.
    """
    inlined = {key: value for key, value in node.items() if key not in ("$ref", "anyOf", "default")}
    if node.get("default") not in (None, [], {}):
        inlined["default"] = node["default"]
    if "$ref" in node:
        inlined = _part(node["$ref"].rpartition("/")[2], parts) | inlined
    for choice in node.get("anyOf", []):
        # If both "integer" and "number" are allowed, "number" comes later and replaces
        # "integer". That is right, because it includes "integer".
        inlined |= {} if choice == {"type": "null"} else _inlined(choice, parts)
    for key in ("items", "additionalProperties"):
        if isinstance(inlined.get(key), dict):
            inlined[key] = _inlined(inlined[key], parts)
    if inlined.get("additionalProperties") == {"type": "string"}:
        # The keys of every table of texts are numbers: values, codes or bits.
        inlined["propertyNames"] = {"pattern": _NUMBER_AS_KEY}
    return inlined


def _part(name: str, parts: dict[str, Any]) -> dict[str, Any]:
    part = {key: value for key, value in parts[name].items() if key != "title" and value != []}
    if "enum" in part:
        return {"type": "string", "enum": part["enum"]}
    part["properties"] = {key: _inlined(value, parts) for key, value in part["properties"].items()}
    return part

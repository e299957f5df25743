"""The profile format as JSON Schema, for editors that complete and check TOML."""

# Draft 7, which the editors' TOML tools read (taplo, Even Better TOML). Types, limits and defaults
# are those of model.py, descriptions its docstrings. Everything stands in its place, without
# references: a description beside a `$ref` does not count in draft 7.
#
# A schema sees one file, so what needs several keys or files (overlaps, points outside their areas,
# `extends`) is left to loading a profile. It asks for one spelling where loading takes several:
# 28bits for a silence, 3 or 0x0E30 for a number as a key.

from __future__ import annotations

import ast
import functools
import inspect
import textwrap
from itertools import pairwise
from typing import Any

import msgspec

from mbtool.devices import model
from mbtool.devices.model import PointType, Profile

_EXTENDS = (
    "A built-in profile's name, or the path of a file from where this one stands; this file then "
    "says only what differs."
)
_FUNCTION_CODE = "^(0[1-9A-Fa-f]|[1-7][0-9A-Fa-f])$"
_NUMBER_AS_KEY = "^-?(0x[0-9A-Fa-f]+|0|[1-9][0-9]*)$"
_PATTERNS = {
    "name": "^[A-Za-z0-9][A-Za-z0-9._-]*$",
    "silence": r"^[0-9]{1,6}(\.[0-9]{1,3})? ?(bits|chars|ms|us)$",
}


def profile_schema() -> dict[str, Any]:
    """A JSON Schema (draft 7) of a profile file."""
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


@functools.cache
def docstrings(part: type) -> dict[str, str]:
    """What stands below each field of a part of the model."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(part))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, below in pairwise(definition.body):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            found[field.target.id] = _text(below)
    return found


def _text(statement: ast.stmt) -> str:
    assert isinstance(statement, ast.Expr)
    assert isinstance(statement.value, ast.Constant)
    paragraphs = inspect.cleandoc(str(statement.value.value)).split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _demand(type_: PointType, key: str) -> dict[str, Any]:
    """A point of this type needs that key."""
    return {
        "if": {"properties": {"type": {"const": type_.value}}, "required": ["type"]},
        "then": {"required": [key]},
    }


def _placed(node: dict[str, Any], parts: dict[str, Any]) -> dict[str, Any]:
    """A schema of msgspec's without references, and without null, which TOML does not have."""
    placed = {key: value for key, value in node.items() if key not in ("$ref", "anyOf", "default")}
    if node.get("default") not in (None, [], {}):
        placed["default"] = node["default"]
    if "$ref" in node:
        placed = _part(node["$ref"].rpartition("/")[2], parts) | placed
    for choice in node.get("anyOf", []):
        # Of "integer or number" the later says both.
        placed |= {} if choice == {"type": "null"} else _placed(choice, parts)
    for key in ("items", "additionalProperties"):
        if isinstance(placed.get(key), dict):
            placed[key] = _placed(placed[key], parts)
    if placed.get("additionalProperties") == {"type": "string"}:
        # Every table of texts is by number: what a value, a code or a bit means.
        placed["propertyNames"] = {"pattern": _NUMBER_AS_KEY}
    return placed


def _part(name: str, parts: dict[str, Any]) -> dict[str, Any]:
    node = parts[name]
    if "enum" in node:
        return {"type": "string", "enum": node["enum"]}
    about = docstrings(getattr(model, name))
    described = {key: node[key] for key in ("type", "description", "additionalProperties")}
    described["properties"] = {
        key: _placed(value, parts) | {"description": about[key]}
        for key, value in node["properties"].items()
    }
    return described | ({"required": node["required"]} if node["required"] else {})

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft7Validator

import mbtool.devices
from mbtool.core import UsageError
from mbtool.core.serial_format import Silence
from mbtool.devices.loading import builtin_profiles, load_profile, profile_to_json
from mbtool.devices.model import Profile
from mbtool.devices.schema import profile_schema

if TYPE_CHECKING:
    from collections.abc import Iterator

SCHEMA = profile_schema()
VALIDATOR = Draft7Validator(SCHEMA)
BUILT_IN = Path(mbtool.devices.__file__).parent / "profiles"

PUMP: dict[str, Any] = {
    "name": "pump",
    "title": "A pump",
    "vendor": "Maker",
    "transports": ["rtu"],
    "source": "its manual",
    "areas": [
        {"name": "data", "table": "holding_registers", "first": 0, "last": 9, "access": "rw"}
    ],
    "functions": {"03": {"limit": 16}, "7F": {}},
}
SPEED: dict[str, Any] = {"name": "Speed", "table": "holding_registers", "address": 3}


def _problems(keys: dict[str, Any]) -> list[str]:
    return [f"{error.json_path}: {error.message}" for error in VALIDATOR.iter_errors(keys)]


def _tables(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        if "properties" in node and "description" in node:
            yield node
        for value in node.values():
            yield from _tables(value)
    if isinstance(node, list):
        for value in node:
            yield from _tables(value)


def test_the_schema_is_valid() -> None:
    Draft7Validator.check_schema(SCHEMA)
    assert json.loads(json.dumps(SCHEMA)) == SCHEMA
    assert "$ref" not in json.dumps(SCHEMA)


def test_every_key_is_described() -> None:
    assert set(SCHEMA["properties"]) == {*Profile.__struct_fields__, "extends"}
    tables = list(_tables(SCHEMA))
    assert len(tables) == 7  # Profile, Area, FunctionRule, AnswerWord, Exceptions, Timing, Point
    for table in tables:
        assert table["additionalProperties"] is False
        for key, value in table["properties"].items():
            assert value["description"].strip(), key
            assert "type" in value, key


@pytest.mark.parametrize("name", builtin_profiles())
def test_built_in_profile_is_valid_as_a_file_and_as_a_whole(name: str) -> None:
    file = tomllib.loads((BUILT_IN / f"{name}.toml").read_text(encoding="utf-8"))
    assert _problems(file) == []
    assert _problems(json.loads(profile_to_json(load_profile(name)))) == []


def test_file_that_extends_another_needs_no_more() -> None:
    assert _problems({"extends": "fa3-at1m8x"}) == []
    assert _problems({"name": "pump"}) != []


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"nane": "x"}, "$: Additional properties are not allowed ('nane' was unexpected)"),
        ({"name": "a b"}, "$.name: 'a b' does not match"),
        ({"name": 5}, "$.name: 5 is not of type 'string'"),
        ({"transports": []}, "$.transports: [] should be non-empty"),
        ({"transports": ["usb"]}, "$.transports[0]: 'usb' is not one of"),
        ({"behaviour": "fa4"}, "$.behaviour: 'fa4' is not one of ['fa3', 'lt830', 'wago']"),
        ({"functions": {"3": {}}}, "$.functions: '3' does not match"),
        ({"functions": {"00": {}}}, "$.functions: '00' does not match"),
        ({"functions": {"83": {}}}, "$.functions: '83' does not match"),
        ({"functions": {"03": {"limit": 0}}}, "$.functions['03'].limit: 0 is less than"),
        ({"functions": {"03": {"limits": 1}}}, "$.functions['03']: Additional properties"),
        ({"exceptions": {"value": 256}}, "$.exceptions.value: 256 is greater than"),
        ({"exceptions": {"texts": {"x": "y"}}}, "$.exceptions.texts: 'x' does not match"),
        ({"timing": {"t3_5": "28 bit times"}}, "$.timing.t3_5: '28 bit times' does not match"),
        ({"areas": [{"name": "data"}]}, "$.areas[0]: 'table' is a required property"),
        ({"points": [SPEED | {"address": -1}]}, "$.points[0].address: -1 is less than"),
        ({"points": [SPEED | {"type": "word"}]}, "$.points[0].type: 'word' is not one of"),
        ({"points": [SPEED | {"type": "string"}]}, "$.points[0]: 'length' is a required"),
        ({"points": [SPEED | {"type": "flags"}]}, "$.points[0]: 'bits' is a required"),
        ({"points": [SPEED | {"texts": {"on": "x"}}]}, "$.points[0].texts: 'on' does not match"),
        ({"points": [SPEED | {"scale": "x"}]}, "$.points[0].scale: 'x' is not of type 'number'"),
    ],
)
def test_wrong_profile_is_refused_at_its_key(keys: dict[str, Any], problem: str) -> None:
    assert _problems(PUMP) == []
    told = _problems(PUMP | keys)[0]
    assert told.startswith(problem)


@given(st.from_regex(r"[0-9]{0,7}(\.[0-9]{0,4})? ?(bits|chars|ms|us|s)", fullmatch=True))
def test_silences_are_those_that_can_be_read(text: str) -> None:
    valid = not _problems(PUMP | {"timing": {"t1_5": text}})
    try:
        Silence.parse(text)
    except UsageError:
        assert not valid or not float(
            text.rstrip("bitscharmu ")
        )  # No pattern tells 0.00 from 0.01.
    else:
        assert valid

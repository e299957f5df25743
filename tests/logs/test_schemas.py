from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from hypothesis import given
from jsonschema import Draft202012Validator

from mbtool.core import Chunk, Packet, WireEvent
from mbtool.logs.messages import ChunkMessage, DecodingMark, EventMessage
from mbtool.logs.points import PointChanges
from mbtool.logs.schemas import EVIDENCE, MESSAGE_TYPES, json_schema
from tests.logs.samples import ONE_OF_EACH, items, stock_messages, write_log

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.logs.messages import LogItem

ALLOWED = {
    "type",
    "properties",
    "required",
    "items",
    "description",
    "title",
    "contentEncoding",
    "oneOf",
}


@pytest.mark.parametrize("name", MESSAGE_TYPES)
def test_a_schema_keeps_to_what_foxglove_reads(name: str) -> None:
    schema = json.loads(json_schema(name))
    Draft202012Validator.check_schema(schema)
    assert schema["type"] == "object"
    assert schema["title"] == name
    for node in nodes(schema):
        assert set(node) <= ALLOWED
        assert node["type"] in {"object", "array", "boolean", "string", "number", "integer"}
        if node["type"] == "object":
            assert node["properties"]
            assert all(property_["description"] for property_ in node["properties"].values())
        for choice in node.get("oneOf", []):
            assert set(choice) == {"title", "const"}
            assert isinstance(choice["const"], int)
        assert node.get("contentEncoding", "base64") == "base64"


@given(items)
def test_every_message_agrees_with_its_schema(item: LogItem) -> None:
    for name, message in messages_of(item):
        Draft202012Validator(json.loads(json_schema(name))).validate(message)


def test_every_topic_of_a_log_agrees_with_its_schema(tmp_path: Path) -> None:
    mark = DecodingMark(ts_ns=1, waiting=2, dropped=3)
    messages = stock_messages(write_log(tmp_path / "x.mcap", (*ONE_OF_EACH, mark)))
    assert {name for _, name, _ in messages} == {*MESSAGE_TYPES, EVIDENCE}
    for _, name, data in messages:
        if name == EVIDENCE:
            continue  # Protobuf: test_evidence_blocks.py.
        schema = json.loads(json_schema(name))
        message = json.loads(data)
        Draft202012Validator(schema).validate(message)
        assert set(message) <= set(schema["properties"])


def test_an_enumeration_of_strings_lists_its_values_in_words() -> None:
    outcome = json.loads(json_schema("mbtool.Transaction"))["properties"]["outcome"]
    assert outcome["type"] == "string"
    assert outcome["description"].endswith(
        ": ok, exception, late, no-answer, not-captured, unsolicited, broadcast, malformed"
    )


def nodes(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield schema
    for property_ in schema.get("properties", {}).values():
        yield from nodes(property_)
    if "items" in schema:
        yield from nodes(schema["items"])


def messages_of(item: LogItem) -> Iterator[tuple[str, Any]]:
    """What a log would hold of an item, without the log."""
    if isinstance(item, Chunk | Packet):
        yield "mbtool.Chunk", msgspec.to_builtins(ChunkMessage.of(item))
    elif isinstance(item, WireEvent):
        yield "mbtool.WireEvent", msgspec.to_builtins(EventMessage.of(item))
    else:
        yield "mbtool.Transaction", msgspec.to_builtins(item)
        for change in PointChanges().changes(item, 0):
            yield "mbtool.PointValue", msgspec.to_builtins(change)

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from mbtool.devices.checking.finding import Finding
from mbtool.devices.checking.rules import RULES
from mbtool.views.findings_document import Checked, Document, JsonDocument, SarifDocument
from tests.troubles.judging import NOTHING

NOON_NS = 1_767_268_800_123_456_789
"""2026-01-01 12:00 UTC and a little."""

FULL = Finding(
    code="FT1A-Q16",
    message="limit is 100",
    ts_ns=NOON_NS,
    link="10.0.0.2",
    source="10.0.0.1:5",
    destination="10.0.0.2:502",
    unit=1,
    function=16,
    reference="HR400001..400110",
    device="idec-ft1a-touch",
    count=3,
)
BARE = Finding(code="RTU-202", message="3 bytes", ts_ns=0, link="rs485")

# What of the schema of SARIF 2.1.0 concerns a log like these: required properties, no others than
# it knows, its enumerations.
_TEXT = {"type": "object", "required": ["text"], "properties": {"text": {"type": "string"}}}
_LEVEL = {"enum": ["none", "note", "warning", "error"]}
_URI = {"type": "string", "pattern": r"^[A-Za-z0-9._~:/?#\[\]@!$&'()*+,;=%-]+$"}


def _object(required: list[str], **properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "additionalProperties": False,
        "required": required,
        "properties": {**properties, "properties": {"type": "object"}},
    }


SARIF = _object(
    ["version", "runs"],
    **{
        "$schema": {"type": "string", "format": "uri"},
        "version": {"const": "2.1.0"},
        "runs": {
            "type": "array",
            "items": _object(
                ["tool", "results"],
                invocations={
                    "type": "array",
                    "items": _object(
                        ["executionSuccessful"],
                        executionSuccessful={"type": "boolean"},
                        toolExecutionNotifications={
                            "type": "array",
                            "items": _object(["message"], level=_LEVEL, message=_TEXT),
                        },
                    ),
                },
                columnKind={"enum": ["utf16CodeUnits", "unicodeCodePoints"]},
                tool=_object(
                    ["driver"],
                    driver=_object(
                        ["name"],
                        name={"type": "string"},
                        version={"type": "string"},
                        rules={
                            "type": "array",
                            "uniqueItems": True,
                            "items": _object(
                                ["id"],
                                id={"type": "string"},
                                shortDescription=_TEXT,
                                help=_TEXT,
                                defaultConfiguration=_object([], level=_LEVEL),
                            ),
                        },
                    ),
                ),
                results={
                    "type": "array",
                    "items": _object(
                        ["message"],
                        ruleId={"type": "string"},
                        ruleIndex={"type": "integer", "minimum": -1},
                        level=_LEVEL,
                        message=_TEXT,
                        occurrenceCount={"type": "integer", "minimum": 1},
                        locations={
                            "type": "array",
                            "items": _object(
                                [],
                                physicalLocation=_object(
                                    ["artifactLocation"], artifactLocation=_object([], uri=_URI)
                                ),
                                logicalLocations={
                                    "type": "array",
                                    "uniqueItems": True,
                                    "items": _object(
                                        [],
                                        name={"type": "string"},
                                        fullyQualifiedName={"type": "string"},
                                        kind={"type": "string"},
                                    ),
                                },
                            ),
                        },
                    ),
                },
            ),
        },
    },
)


def written(document: Document, *findings: Finding, place: str = "plant.pcap") -> Any:
    text = document.begin() + "".join(document.add(one, place) for one in findings)
    return json.loads(text + document.end(Checked(42, {"no_answer": 3}, NOTHING)))


def test_json_is_one_object_with_all_fields_of_the_findings() -> None:
    document = written(JsonDocument("1.2"), FULL, BARE, BARE)
    assert (document["version"], document["transactions"]) == ("1.2", 42)
    assert document["failed_requests"] == {"no_answer": 3}
    full, bare, _ = document["findings"]
    assert full == {
        "code": "FT1A-Q16",
        "severity": "error",
        "message": "limit is 100",
        "ts_ns": NOON_NS,
        "time": "2026-01-01T12:00:00.123456Z",
        "link": "10.0.0.2",
        "source": "10.0.0.1:5",
        "destination": "10.0.0.2:502",
        "unit": 1,
        "function": 16,
        "reference": "HR400001..400110",
        "device": "idec-ft1a-touch",
        "count": 3,
        "file": "plant.pcap",
    }
    assert set(bare) == {"code", "severity", "message", "ts_ns", "time", "link", "count", "file"}
    assert set(document["rules"]) == {"FT1A-Q16", "RTU-202"}
    assert document["rules"]["RTU-202"]["meaning"] == "Bytes on the line are no frame."


def test_sarif_is_a_run_of_the_schema() -> None:
    document = written(SarifDocument("1.2"), FULL, BARE, FULL)
    jsonschema.validate(document, SARIF)
    (run,) = document["runs"]
    assert run["properties"] == {"transactions": 42, "failed_requests": {"no_answer": 3}}
    assert [one["id"] for one in run["tool"]["driver"]["rules"]] == ["FT1A-Q16", "RTU-202"]
    assert [one["ruleIndex"] for one in run["results"]] == [0, 1, 0]
    first = run["results"][0]
    assert (first["ruleId"], first["level"], first["occurrenceCount"]) == ("FT1A-Q16", "error", 3)
    (location,) = first["locations"]
    assert location["physicalLocation"]["artifactLocation"]["uri"] == "plant.pcap"
    (logical,) = location["logicalLocations"]
    assert logical["fullyQualifiedName"] == "10.0.0.2/unit 1/HR400001..400110"


def test_a_rule_of_sarif_says_why_it_is_one_and_who_says_so() -> None:
    (run,) = written(SarifDocument("1.2"), FULL, BARE)["runs"]
    quantity, bytes_ = (rule["help"]["text"] for rule in run["tool"]["driver"]["rules"])
    assert quantity == (
        "The quantity is 0 or more than the device's manual allows for the function. "
        "Source: manual of the device, as its profile has it. docs/findings.md, section Q"
    )
    assert bytes_ == (
        "Bytes on the line are no frame. "
        "Source: Serial Line 2.5.1.1. docs/findings.md, section RTU-202"
    )


def test_every_rule_has_its_help_and_its_section_in_the_page() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "findings.md").read_text()
    codes = [f"OWN-{code}3" if rule.is_of_devices else code for code, rule in RULES.items()]
    (run,) = written(SarifDocument("1"), *(replace(BARE, code=code) for code in codes))["runs"]
    rules = run["tool"]["driver"]["rules"]
    assert [rule["id"] for rule in rules] == codes
    for rule, (code, row) in zip(rules, RULES.items(), strict=True):
        assert row.meaning in rule["help"]["text"]
        assert row.source in rule["help"]["text"]
        assert rule["help"]["text"].endswith(f" section {code}")
        assert f"\n### {code}\n" in page


def test_a_rule_of_another_edition_has_its_code_only() -> None:
    odd = Finding(code="MB-999", message="x", ts_ns=0, link="x")
    document = written(SarifDocument("1"), odd)
    jsonschema.validate(document, SARIF)
    (rule,) = document["runs"][0]["tool"]["driver"]["rules"]
    assert (rule["id"], rule["shortDescription"]["text"]) == ("MB-999", "MB-999")
    assert "help" not in rule


@pytest.mark.parametrize("document", [JsonDocument, SarifDocument])
def test_a_document_without_findings_is_complete(document: type[Document]) -> None:
    empty = written(document("1"))  # type: ignore[call-arg]
    assert empty.get("findings", empty.get("runs", [{}])[0].get("results")) == []


def test_file_names_with_undecodable_bytes_are_written() -> None:
    for place in ("a b/#1.pcap", "C:\\x.pcap", "bad\udce9.pcap", "-"):
        jsonschema.validate(written(SarifDocument("1"), BARE, place=place), SARIF)
        written(JsonDocument("1"), BARE, place=place)


def test_sarif_names_a_file_by_the_bytes_of_its_path() -> None:
    shown, path = "o2/\\xff\\xfe.pcap", "o2/\udcff\udcfe.pcap"
    (run,) = written(SarifDocument("1", {shown: path}), BARE, place=shown)["runs"]
    (location,) = run["results"][0]["locations"]
    assert location["physicalLocation"]["artifactLocation"]["uri"] == "o2/%FF%FE.pcap"


@pytest.mark.parametrize("is_whole", [True, False])
def test_documents_say_what_was_not_checked(*, is_whole: bool) -> None:
    json_, sarif = JsonDocument("1"), SarifDocument("1")
    told: list[Any] = [
        json.loads(one.begin() + one.end(Checked(1, {}, NOTHING, ["cut"], is_whole)))
        for one in (json_, sarif)
    ]
    assert (told[0]["is_whole"], told[0]["remarks"]) == (is_whole, ["cut"])
    jsonschema.validate(told[1], SARIF)
    assert told[1]["runs"][0]["invocations"] == [
        {
            "executionSuccessful": is_whole,
            "toolExecutionNotifications": [{"level": "warning", "message": {"text": "cut"}}],
        }
    ]


def test_a_time_beyond_the_calendar_is_left_out() -> None:
    odd = Finding(code="MB-401", message="x", ts_ns=10**30, link="x")
    (finding,) = written(JsonDocument("1"), odd)["findings"]
    assert "time" not in finding
    assert finding["ts_ns"] == 10**30

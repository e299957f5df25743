"""An inventory as a CycloneDX bill of materials."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jsonschema
import pytest
from referencing import Registry, Resource

from mbtool.ledger.inventory_rows import InventoryDocument, MasterRow, SlaveRow
from mbtool.modbus import Outcome, mbap_adu
from mbtool.views.inventory_cyclonedx import inventory_cyclonedx
from tests.captures import public_folder
from tests.ledger.plant import asked, inventory_of, plant

if TYPE_CHECKING:
    from collections.abc import Iterator

SCHEMAS = "MBTOOL_CYCLONEDX_SCHEMAS"
"""The folder with the published schema, CycloneDX 1.6, and the two that it refers to."""
_FILES = ("bom-1.6.schema.json", "spdx.schema.json", "jsf-0.82.schema.json")


def bom(document: InventoryDocument) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(inventory_cyclonedx(document, "1.2.3"))
    return data


def components(data: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for one in data.get("components", ()):
        yield one
        yield from components(one)


def properties(component: dict[str, Any]) -> list[tuple[str, str]]:
    return [(one["name"], one["value"]) for one in component["properties"]]


def whole_plant() -> InventoryDocument:
    """The plant with identities, MAC addresses and a line."""
    objects = b"\x01\x04ACME" + b"\x02\x031.0"
    response = bytes.fromhex("2b 0e 01 01 00 00 02") + objects.replace(b"\x01\x04", b"\x00\x04", 1)
    document = inventory_of(
        [
            *plant(),
            asked(0x2B, response_raw=mbap_adu(0, 1, response)),
            asked(3, 0, 1, slave=None),
            asked(3, 0, 1, slave="10.0.0.99", outcome=Outcome.NO_ANSWER),
        ]
    )
    document.slaves[0].macs, document.slaves[0].makers = ["00:30:de:01:02:03"], ["WAGO"]
    document.masters[0].macs = ["00:0c:29:01:02:03"]
    return document


def test_it_has_the_fields_that_the_specification_requires() -> None:
    data = bom(whole_plant())
    assert (data["bomFormat"], data["specVersion"], data["version"]) == ("CycloneDX", "1.6", 1)
    every = list(components(data))
    assert {one["type"] for one in every} == {"device"}
    assert all(one["name"] for one in every)
    refs = [one["bom-ref"] for one in every]
    assert len(refs) == len(set(refs))
    for one in data["dependencies"]:
        assert {one["ref"], *one["dependsOn"]} <= set(refs)


def test_hosts_hold_their_units_with_what_is_known() -> None:
    data = bom(whole_plant())
    host = next(one for one in data["components"] if one["bom-ref"] == "slave:10.0.0.10")
    assert host["manufacturer"] == {"name": "WAGO"}
    assert ("mbtool:mac", "00:30:de:01:02:03") in properties(host)
    (unit,) = host["components"]
    assert (unit["manufacturer"], unit["version"]) == ({"name": "ACME"}, "1.0")
    assert ("mbtool:writes", "10 write registers 10..11 by 10.0.0.1") in properties(unit)
    assert ("mbtool:writer", "10.0.0.1") in properties(unit)


def test_masters_depend_on_the_hosts_that_they_ask() -> None:
    asked_by = {one["ref"]: one["dependsOn"] for one in bom(whole_plant())["dependencies"]}
    assert asked_by["master:10.0.0.2"] == ["slave:10.0.0.10"]


def test_who_never_answered_is_no_device() -> None:
    assert "10.0.0.99" not in inventory_cyclonedx(whole_plant(), "1")


def test_the_same_inventory_gives_the_same_document() -> None:
    first, second = (inventory_cyclonedx(whole_plant(), "1") for _ in range(2))
    assert first == second
    assert bom(inventory_of(plant()))["serialNumber"] != bom(whole_plant())["serialNumber"]


@pytest.mark.parametrize(
    "document",
    [
        whole_plant(),
        InventoryDocument(format=""),
        InventoryDocument(
            format="",
            slaves=[SlaveRow(host='"\x1b\n', unit=1, macs=["\x00"], makers=["\ud800"])],
            masters=[MasterRow(host="10.0.0.1")],
        ),
    ],
    ids=["plant", "empty", "hostile"],
)
def test_it_is_valid_by_the_published_schema(document: InventoryDocument) -> None:
    folder = Path(os.environ.get(SCHEMAS) or public_folder().parent / "schemas" / "cyclonedx")
    if not all((folder / name).exists() for name in _FILES):
        pytest.skip(f"no schema of CycloneDX: set {SCHEMAS} to the folder of {', '.join(_FILES)}")
    schemas = [json.loads((folder / name).read_text()) for name in _FILES]
    resources = ((one["$id"], Resource.from_contents(one)) for one in schemas)
    registry: Any = Registry().with_resources(resources)
    validator = jsonschema.Draft7Validator(schemas[0], registry=registry)
    assert [error.message for error in validator.iter_errors(bom(document))] == []

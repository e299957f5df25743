"""Writes an inventory as a CycloneDX bill of materials, for asset management."""

# CycloneDX 1.6, JSON. Each host is a component of type "device"; inside it, each unit that answered
# is a component of type "device". Masters are devices, too. Facts for which CycloneDX has no field
# are in properties whose names begin with "mbtool:". A master depends on the hosts that it sends
# requests to; a host depends on no other.
#
# The serial number is computed from the content, so that the same inventory gives the same
# document.

from __future__ import annotations

import json
import uuid
from typing import TYPE_CHECKING, Any

from mbtool.ledger.inventory_ranges import MAX_RANGES, ranges_text
from mbtool.ledger.inventory_rows import Role, iso_time
from mbtool.views.inventory_table import UNKNOWN, function_label
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.ledger.inventory_rows import InventoryDocument, MasterRow, SlaveRow

SPEC_VERSION = "1.6"
_QUIET = (Role.SILENT, Role.UNHEARD)
_SPACE = uuid.UUID("6e0f4c3a-2f8b-5c7e-9a55-3f6a1f5f7d10")
"""The UUID namespace of serial numbers: a random constant. Another value would change the serial
numbers of all documents."""


def inventory_cyclonedx(document: InventoryDocument, version: str) -> str:
    """Return the inventory as CycloneDX text (JSON), with a line end.

    `version` is that of mbtool.
    """
    places: dict[str, list[SlaveRow]] = {}
    for row in document.slaves:
        if row.role not in _QUIET:
            places.setdefault(row.where, []).append(row)
    components = [_host(where, rows) for where, rows in places.items()]
    components += [_master(row) for row in document.masters]
    body = {
        "components": components,
        "dependencies": list(_dependencies(document, places)),
    }
    serial = uuid.uuid5(_SPACE, json.dumps(body, sort_keys=True))
    bom = {
        "$schema": f"http://cyclonedx.org/schema/bom-{SPEC_VERSION}.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": SPEC_VERSION,
        "serialNumber": f"urn:uuid:{serial}",
        "version": 1,
        "metadata": {
            "tools": {"components": [{"type": "application", "name": "mbtool", "version": version}]}
        },
        **body,
    }
    return json.dumps(bom, indent=2) + "\n"


def _host(where: str, rows: Sequence[SlaveRow]) -> dict[str, Any]:
    macs = list(dict.fromkeys(mac for row in rows for mac in row.macs))
    makers = list(dict.fromkeys(name for row in rows for name in row.makers))
    role = rows[0].role.value if len({row.role for row in rows}) == 1 else Role.GATEWAY.value
    pairs = [("role", role), *(("mac", mac) for mac in macs)]
    return _component(
        f"slave:{where}",
        where,
        pairs,
        maker=makers[0] if makers else None,
        inner=[_unit(where, row) for row in rows],
    )


def _unit(where: str, row: SlaveRow) -> dict[str, Any]:
    texts = {one.name: one.text for one in row.identity}
    name = texts.get("product") or texts.get("model") or texts.get("product code")
    pairs = [
        ("unit", str(row.unit)),
        ("role", row.role.value),
        *(("transport", one) for one in row.transports),
        *(("identity", f"{one.name}: {one.text}") for one in row.identity),
        *(("reads" if not use.writes else "writes", _use_text(use)) for use in row.uses),
        *(("writer", master) for master in row.masters(writing=True)),
        ("first seen", iso_time(row.first_ns)),
        ("last seen", iso_time(row.last_ns)),
    ]
    if row.device is not None:
        pairs.append(("profile named", row.device))
    if row.fit is not None:
        pairs.append(("profile", row.fit.profile or UNKNOWN))
        pairs.append(("profile score", str(row.fit.score)))
    return _component(
        f"slave:{where}/{row.unit}",
        name or f"{where} unit {row.unit}",
        pairs,
        maker=texts.get("vendor"),
        version=texts.get("revision"),
    )


def _use_text(use: Any) -> str:
    label = function_label(use.function, use.name)
    by = f" by {use.master}" if use.master is not None else ""
    return f"{label} {ranges_text(use.all_ranges, MAX_RANGES)}".rstrip() + by


def _master(row: MasterRow) -> dict[str, Any]:
    pairs = [
        ("role", Role.MASTER.value),
        *(("mac", mac) for mac in row.macs),
        ("first seen", iso_time(row.first_ns)),
        ("last seen", iso_time(row.last_ns)),
    ]
    maker = row.makers[0] if row.makers else None
    return _component(f"master:{row.host}", row.host, pairs, maker=maker)


def _component(
    ref: str,
    name: str,
    pairs: Sequence[tuple[str, str]],
    *,
    maker: str | None = None,
    version: str | None = None,
    inner: Sequence[dict[str, Any]] = (),
) -> dict[str, Any]:
    component: dict[str, Any] = {
        "type": "device",
        "bom-ref": printable(ref),
        "name": printable(name),
    }
    if maker:
        component["manufacturer"] = {"name": printable(maker)}
    if version:
        component["version"] = printable(version)
    component["properties"] = [
        {"name": f"mbtool:{key}", "value": printable(value)} for key, value in pairs
    ]
    if inner:
        component["components"] = list(inner)
    return component


def _dependencies(
    document: InventoryDocument, places: dict[str, list[SlaveRow]]
) -> Iterator[dict[str, Any]]:
    asked: dict[str, list[str]] = {row.host: [] for row in document.masters}
    for where, rows in places.items():
        for master in dict.fromkeys(master for row in rows for master in row.masters()):
            asked.setdefault(master, []).append(printable(f"slave:{where}"))
    for row in document.masters:
        yield {"ref": printable(f"master:{row.host}"), "dependsOn": asked[row.host]}

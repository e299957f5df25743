"""A log may hold any text and number: every form of an inventory takes them."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING

import pytest
from rich.console import Console

from mbtool.ledger.baseline import changes
from mbtool.modbus import mbap_adu
from mbtool.views.inventory_documents import changes_csv, inventory_csv, inventory_json
from mbtool.views.inventory_table import print_changes, print_inventory
from tests.ledger.plant import asked, inventory_of, plant

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.ledger.inventory_rows import InventoryDocument

EVIL = '=cmd|"\x1b]0;x\x07\r\n\\"];\u202e['

HOSTILE = {
    "texts": asked(3, 0, 1, slave=EVIL, master=EVIL, device=EVIL, source_mac=EVIL),
    "no ports": asked(3, 0, 1, source=EVIL, destination=EVIL, destination_mac=EVIL),
    "empty": asked(3, 0, 1, source="", destination="", link=""),
    "numbers below 0": asked(-3, -5, -1, unit=-5, latency_ns=-1, exception=-1),
    "large numbers": asked(10**6, 10**9, 10**9, unit=10**9, request_ns=2**63, response_ns=2**63),
    "times before 1970": asked(3, 0, 1, request_ns=-(2**62), response_ns=-(2**62)),
    "no time": asked(3, 0, 1, request_ns=None, response_ns=None),
    "a name of a function": asked(0x50, function_name=EVIL),
    "an answer": asked(0x2B, response_raw=b"\xff"),
    "a model code": asked(0x99, response_raw=mbap_adu(0, 1, b"\x99\x00\x16")),
}


def forms(document: InventoryDocument) -> dict[str, str]:
    """The inventory in every form."""
    out = io.StringIO()
    console = Console(file=out, width=80, force_terminal=True, color_system=None)
    print_inventory(console, document)
    print_inventory(console, document, everything=True)
    new = changes(inventory_of(plant()), document)
    print_changes(console, new)
    return {
        "table": out.getvalue(),
        "json": inventory_json(document, "1", new),
        "csv": inventory_csv(document),
        "changes": changes_csv(new),
    }


@pytest.mark.parametrize("transaction", HOSTILE.values(), ids=list(HOSTILE))
def test_every_form_is_well_formed_and_steers_nothing(transaction: NamedTransaction) -> None:
    made = forms(inventory_of([*plant(), transaction]))
    json.loads(made["json"])
    for name in ("csv", "changes"):
        rows = list(csv.reader(made[name].splitlines()))
        assert len({len(row) for row in rows}) == 1
        assert not any(cell.startswith(("=", "+", "@", "\t")) for row in rows for cell in row)
    for name in ("table", "csv", "changes"):
        assert not set("\x1b\x07\r\u202e") & set(made[name].replace("\x1b[1m", ""))

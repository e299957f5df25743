"""An inventory as a graph for Graphviz."""

from __future__ import annotations

import re

from mbtool.ledger.inventory_rows import InventoryDocument, SlaveRow
from mbtool.modbus import Outcome
from mbtool.views.inventory_graph import inventory_dot
from tests.ledger.plant import asked, inventory_of, plant

# A statement in the language of Graphviz, as far as it is used: a node, an arrow or an attribute.
STRING = r'"(?:[^"\\]|\\.)*"'
VALUE = rf"(?:{STRING}|\w+)"
ATTRIBUTES = rf"\[\w+={VALUE}(?:, \w+={VALUE})*\]"
STATEMENT = re.compile(
    rf"(?:{STRING}(?: -> {STRING})?|node|edge) {ATTRIBUTES};?|\w+={VALUE};", re.DOTALL
)


def statements(text: str) -> list[str]:
    """The statements of a graph; each must be one of the language."""
    lines = text.splitlines()
    assert (lines[0], lines[-1]) == ("digraph inventory {", "}")
    for line in lines[1:-1]:
        rest = STATEMENT.sub("", line).strip()
        assert not rest, line
    return [line.strip() for line in lines[1:-1]]


def test_masters_and_hosts_are_boxes_and_arrows_say_which_functions() -> None:
    found = statements(inventory_dot(inventory_of(plant())))
    assert found[1:] == [
        '"master 10.0.0.1" [label="10.0.0.1", style=rounded];',
        '"master 10.0.0.2" [label="10.0.0.2", style=rounded];',
        '"slave 10.0.0.10" [label="10.0.0.10\\nunit 1: vendor \\"ACME\\""];',
        '"slave 10.0.0.20" [label="10.0.0.20\\nunit 3\\nunit 4"];',
        '"master 10.0.0.1" -> "slave 10.0.0.10" [label="03 10 2B", color=red, penwidth=2];',
        '"master 10.0.0.2" -> "slave 10.0.0.10" [label="03"];',
        '"master 10.0.0.1" -> "slave 10.0.0.20" [label="04"];',
    ]


def test_who_never_answered_is_only_counted() -> None:
    silent = asked(3, 0, 1, slave="10.0.0.30", outcome=Outcome.NO_ANSWER)
    text = inventory_dot(inventory_of([*plant(), silent]))
    assert "10.0.0.30" not in text
    assert 'label="1 more never answered";' in text


def test_no_name_ends_its_string() -> None:
    evil = 'a"];x->y["\\'
    row = SlaveRow(host=evil, unit=1, macs=[evil], makers=[f"{evil}\n"])
    found = statements(inventory_dot(InventoryDocument(format="", slaves=[row])))
    assert len(found) == 2


def test_many_units_are_counted() -> None:
    text = inventory_dot(inventory_of(asked(3, 0, 1, unit=unit) for unit in range(1, 41)))
    assert "and 16 more units" in text

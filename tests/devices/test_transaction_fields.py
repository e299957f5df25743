"""The classes of a transaction are the only list of its fields."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Annotated

import pyarrow as pa
import pytest

from mbtool.columns.schema import SCHEMA, schema_of
from mbtool.devices import NamedTransaction
from mbtool.devices.transaction_fields import TIME, column_names, transaction_fields
from mbtool.logs.schemas import _object
from mbtool.modbus.transaction import Word, about

ROOT = Path(__file__).resolve().parents[2] / "mbtool"
NAMES = {one.name for one in transaction_fields()}
MOST = 0.6
"""A list of more than this share (0 to 1) of the names is a second list of fields."""


class WithMore(NamedTransaction, frozen=True, kw_only=True, omit_defaults=True):
    """A transaction with a further field."""

    rack: Annotated[Word | None, about("The rack of the device")] = None


def test_a_new_field_comes_last_in_every_form() -> None:
    for form in ("csv", "table"):
        names = column_names(form, WithMore)
        assert names == (*column_names(form), "rack")
    assert schema_of(WithMore).field("rack").type == pa.uint16()
    schema = _object(WithMore)["properties"]["rack"]
    assert schema == {"type": "integer", "description": "The rack of the device"}


@pytest.mark.parametrize("form", ["csv", "table"])
def test_each_place_of_a_column_is_given_once(form: str) -> None:
    places = [one.places[form] for one in transaction_fields()]
    given = sorted(place for place in places if place is not None)
    names = column_names(form)
    assert given == [place for place in range(len(names)) if place != names.index(TIME)]


def test_the_columns_are_those_of_the_fields() -> None:
    assert {*column_names("csv")} == {*SCHEMA.names} == {*NAMES, TIME}
    assert {*NamedTransaction.__struct_fields__} == NAMES
    assert all(one.text for one in transaction_fields())


def test_no_other_file_lists_the_fields() -> None:
    for path in ROOT.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Tuple | ast.List | ast.Set):
                items = node.elts
                texts = {one.value for one in items if isinstance(one, ast.Constant)}
                pairs = [one.elts[0] for one in items if isinstance(one, ast.Tuple) and one.elts]
                texts |= {one.value for one in pairs if isinstance(one, ast.Constant)}
                assert len(texts & NAMES) < MOST * len(NAMES), f"{path}:{node.lineno}"

"""The four tables."""

from __future__ import annotations

from mbtool.modbus.tables import Table


def test_tables_differ_in_what_they_hold_and_who_may_write() -> None:
    assert [(table.value, table.is_bits, table.is_writable) for table in Table] == [
        ("coils", True, True),
        ("discrete_inputs", True, False),
        ("holding_registers", False, True),
        ("input_registers", False, False),
    ]

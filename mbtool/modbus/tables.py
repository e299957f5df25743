"""The four tables of the Modbus data model (V1.1b3, section 4.3)."""

from __future__ import annotations

from enum import StrEnum

ADDRESSES = 0x10000
"""The number of addresses in a table."""


class Table(StrEnum):
    """One of the four tables; the same address can exist in each of them."""

    COILS = "coils"
    DISCRETE_INPUTS = "discrete_inputs"
    HOLDING_REGISTERS = "holding_registers"
    INPUT_REGISTERS = "input_registers"

    @property
    def is_bits(self) -> bool:
        return self in (Table.COILS, Table.DISCRETE_INPUTS)

    @property
    def is_writable(self) -> bool:
        return self in (Table.COILS, Table.HOLDING_REGISTERS)


READS_OF_TABLE = {
    Table.COILS: 0x01,
    Table.DISCRETE_INPUTS: 0x02,
    Table.HOLDING_REGISTERS: 0x03,
    Table.INPUT_REGISTERS: 0x04,
}
"""The function code that reads each table."""

DIGIT_TABLES = {
    "0": Table.COILS,
    "1": Table.DISCRETE_INPUTS,
    "3": Table.INPUT_REGISTERS,
    "4": Table.HOLDING_REGISTERS,
}
"""The table that the first digit of a register reference means: 40011 is holding register 10."""

"""What a device says about itself (functions 2B/0E and 11H), as values for tables and logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.named import PointValue
from mbtool.modbus.identification import identities

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction


def identity_points(transaction: Transaction) -> list[PointValue]:
    """A value for each thing that the answer says; empty for the answers to other functions."""
    return [
        PointValue(
            name=one.name,
            reference=f"{transaction.function:02X}H"
            if one.number is None
            else f"object {one.number:02X}H",
            text=one.text,
        )
        for one in identities(transaction)
    ]

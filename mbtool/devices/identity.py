"""What a device says about itself: by functions 2B/0E and 11H, and by a maker's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.named_transaction import PointValue
from mbtool.modbus.identification import identities
from mbtool.modbus.pdu import whole_pdu

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


def answer_word(transaction: Transaction) -> int | None:
    """The word behind the function code, where that is the whole answer: FA3's model code."""
    if transaction.exception is not None:
        return None
    pdu = whole_pdu(transaction.transport, transaction.response_raw)
    return int.from_bytes(pdu[1:]) if pdu is not None and len(pdu) == 3 else None

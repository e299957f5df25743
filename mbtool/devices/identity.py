"""Reads the identity that a device reports, with function 2B/0E or 11H or a vendor's function."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.named_transaction import PointValue
from mbtool.modbus.identification import identities
from mbtool.modbus.pdu import whole_pdu

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction


def identity_points(transaction: Transaction) -> list[PointValue]:
    """Return a point value for each part of the identity (such as the vendor's name) in a response.

    Empty if the response reports no identity.
    """
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
    """The 16-bit word after the response's function code. None if the response has other data, or
    is an exception response.

    FA3 modules report their model code in this form.
    """
    if transaction.exception is not None:
        return None
    pdu = whole_pdu(transaction.transport, transaction.response_raw)
    return int.from_bytes(pdu[1:]) if pdu is not None and len(pdu) == 3 else None

"""Checks one transaction against the Modbus standard; the results are finding codes."""

# Most transactions break no rule, and for these the checks are fast. The result of `request_codes`
# depends only on function, address and quantity, so naming.py calls it once for each combination. A
# transaction whose PDU is malformed has a verdict from the decoder; only then the bytes of the PDU
# are parsed again. Padding bits are checked only for reads and writes of bits.

from __future__ import annotations

from collections.abc import Iterator

from mbtool.core import Direction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.expected_response import mismatch
from mbtool.modbus.functions import (
    EXCEPTION_BIT,
    FUNCTIONS,
    READ_BITS,
    READ_REGISTERS,
    WRITE_LIMIT_17H,
    WRITE_ONE,
    WRITE_SEVERAL,
)
from mbtool.modbus.pdu import parse_pdu, pdu_length, whole_pdu
from mbtool.modbus.tables import ADDRESSES
from mbtool.modbus.transaction import Outcome, Transaction

RESERVED = frozenset((9, 10, 13, 14, 41, 42, 91, 125, 126, 127))
"""The function codes that the standard reserves for old products of some companies (Application
Protocol, Annex A), without 90 (5AH), of which SEC-103 tells what matters."""
_WRITE_BITS = 0x0F
_HAS_PADDING = READ_BITS | {_WRITE_BITS}
_BYTE_COUNT_END = {0x0F: 6, 0x10: 6, 0x17: 10}
"""By function code: the number of bytes of a request's PDU up to and including its byte count.
Functions whose requests have no byte count are missing."""
_RESPONSE_HAS_BYTE_COUNT = READ_BITS | READ_REGISTERS
_RESPONSE_REPEATS_REQUEST = WRITE_ONE | WRITE_SEVERAL
_MALFORMED = frozenset((Verdict.MALFORMED_REQUEST, Verdict.MALFORMED_RESPONSE))


def request_codes(
    function: int, address: int | None, quantity: int | None, written: tuple[int, int] | None = None
) -> Iterator[str]:
    """Give the finding codes for the function, the addresses and the quantities of a request.

    `written` is the first address and the quantity that a request with function 17H writes; None
    for other functions.
    """
    if not 0 < function < EXCEPTION_BIT:
        yield "MB-107"
        return
    if function in RESERVED:
        yield "MB-109"
    if is_quantity_wrong(function, quantity, written):
        yield "MB-104"
    ends = [written[0] + written[1]] if written is not None else []
    if address is not None and quantity is not None:
        ends.append(address + quantity)
    if any(end > ADDRESSES for end in ends):
        yield "MB-106"


def is_quantity_wrong(
    function: int, quantity: int | None, written: tuple[int, int] | None = None
) -> bool:
    """True if a quantity in a request is 0, or more than the standard allows for the function.

    `written` is the first address and the quantity that a request with function 17H writes; None
    for other functions.
    """
    known = FUNCTIONS.get(function)
    if known is None or known.table is None:
        return False
    if written is not None and not 1 <= written[1] <= WRITE_LIMIT_17H:
        return True
    return quantity is not None and not 1 <= quantity <= known.limit


def form_codes(transaction: Transaction) -> list[str]:
    """Return the finding codes for a malformed request or response and for padding bits that are
    not 0.

    Never raises.
    """
    if transaction.verdicts and not _MALFORMED.isdisjoint(transaction.verdicts):
        return _malformed_codes(transaction)
    if transaction.function in _HAS_PADDING and padding_of(transaction) is not None:
        return ["MB-105" if transaction.function == _WRITE_BITS else "MB-204"]
    return []


def _malformed_codes(transaction: Transaction) -> list[str]:
    codes = []
    if Verdict.MALFORMED_REQUEST in transaction.verdicts:
        codes.append(request_form(transaction)[0])
    if Verdict.MALFORMED_RESPONSE in transaction.verdicts:
        broken = response_form(transaction)
        if broken is not None:
            codes.append(broken[0])
    return codes


def request_form(transaction: Transaction) -> tuple[str, str]:
    """Return the finding code of a malformed request, and in words what is wrong with it.

    Call it only for a transaction with the verdict MALFORMED_REQUEST.
    """
    pdu = _pdu(transaction, transaction.request_raw)
    problem = parse_pdu(pdu, Direction.REQUEST).problem or "its form is wrong"
    function = transaction.function
    if function == 0x05 and len(pdu) == 5:
        return "MB-103", problem
    if function in _BYTE_COUNT_END and len(pdu) >= _BYTE_COUNT_END[function]:
        return "MB-101", problem
    return "MB-102", problem


def response_form(transaction: Transaction) -> tuple[str, str] | None:
    """Return the finding code of a malformed response, and in words what is wrong with it.

    None if the response correctly repeats a malformed request. Call it only for a transaction with
    the verdict MALFORMED_RESPONSE.
    """
    request_pdu = _pdu(transaction, transaction.request_raw)
    pdu = _pdu(transaction, transaction.response_raw)
    if pdu == request_pdu and Verdict.MALFORMED_REQUEST in transaction.verdicts:
        return None
    request = parse_pdu(request_pdu, Direction.REQUEST)
    response = parse_pdu(pdu, Direction.RESPONSE)
    problem = response.problem or mismatch(request, response) or "its form is wrong"
    if pdu and pdu[0] & EXCEPTION_BIT:
        problem = f"an exception of {len(pdu)} bytes, where one has 2"
    else:
        if transaction.function in _RESPONSE_HAS_BYTE_COUNT and len(pdu) > 1:
            return "MB-202", problem
        repeats = transaction.function in _RESPONSE_REPEATS_REQUEST
        if repeats and pdu_length(pdu, Direction.RESPONSE) == len(pdu):
            return "MB-201", problem
    return "MB-203", problem


def padding_of(transaction: Transaction) -> tuple[int, int] | None:
    """Find padding bits that are not 0: unused high bits in the last byte of coils or inputs.

    Returns that byte, and the number of its bits that are values. None if all padding bits are 0.
    """
    used = (transaction.quantity or 0) % 8
    if not used:
        return None
    if transaction.function == _WRITE_BITS:
        pdu = _pdu(transaction, transaction.request_raw)
    elif transaction.outcome in (Outcome.OK, Outcome.LATE):
        pdu = _pdu(transaction, transaction.response_raw)
    else:
        return None
    return (pdu[-1], used) if len(pdu) > 2 and pdu[-1] >> used else None


def _pdu(transaction: Transaction, raw: bytes | None) -> bytes:
    """Return the PDU in `raw`, the bytes of an ADU; empty if `raw` is None or has no readable
    PDU.
    """
    return whole_pdu(transaction.transport, raw) or b""

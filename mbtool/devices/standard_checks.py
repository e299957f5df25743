"""What the standard itself says of a request and its answer, as codes of broken rules."""

# Most transactions break none of these rules, and are asked only what is quickly asked: what a
# request wants depends on function, address and quantity, and is worked out once for each
# combination (naming.py); what is wrong with the form of a PDU is known by a verdict; and only
# reads and writes of bits have padding. The bytes are parsed again where a verdict says so.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import EXCEPTION_BIT, FUNCTIONS, WRITE_LIMIT_17H
from mbtool.modbus.pdu import parse_pdu, pdu_length, whole_pdu
from mbtool.modbus.request_match import mismatch
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.modbus.transaction import Transaction

ADDRESSES = 1 << 16

_READ_BITS = (0x01, 0x02)
_WRITE_BITS = 0x0F
_HAS_PADDING = frozenset((*_READ_BITS, _WRITE_BITS))
_COUNTED_REQUESTS = {0x0F: 6, 0x10: 6, 0x17: 10}
"""Functions whose requests have a byte count, and how long they are up to it."""
_COUNTED_ANSWERS = frozenset((0x01, 0x02, 0x03, 0x04, 0x17))
_ECHOES = frozenset((0x05, 0x06, 0x0F, 0x10, 0x16))
_MALFORMED = frozenset((Verdict.MALFORMED_REQUEST, Verdict.MALFORMED_RESPONSE))


def request_codes(
    function: int, address: int | None, quantity: int | None, written: tuple[int, int] | None = None
) -> Iterator[str]:
    """Codes for what a request asks for. `written` is what function 17H writes: where, how many."""
    if not 0 < function < EXCEPTION_BIT:
        yield "MB-107"
        return
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
    """Whether the standard does not allow a quantity for a function."""
    known = FUNCTIONS.get(function)
    if known is None or known.table is None:
        return False
    if written is not None and not 1 <= written[1] <= WRITE_LIMIT_17H:
        return True
    return quantity is not None and not 1 <= quantity <= known.limit


def form_codes(transaction: Transaction) -> list[str]:
    """Codes for the form of both PDUs. Never raises, whatever the bytes."""
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
    """The code for a request that is known to be malformed, and what is wrong."""
    pdu = _pdu(transaction, transaction.request_raw)
    problem = parse_pdu(pdu, Direction.REQUEST).problem or "its form is wrong"
    function = transaction.function
    if function == 0x05 and len(pdu) == 5:
        return "MB-103", problem
    if function in _COUNTED_REQUESTS and len(pdu) >= _COUNTED_REQUESTS[function]:
        return "MB-101", problem
    return "MB-102", problem


def response_form(transaction: Transaction) -> tuple[str, str] | None:
    """The code for an answer that is known to be malformed, and what is wrong.

    None for the true echo of a request that is malformed itself.
    """
    asked_pdu = _pdu(transaction, transaction.request_raw)
    pdu = _pdu(transaction, transaction.response_raw)
    if pdu == asked_pdu:
        return None
    asked, answered = parse_pdu(asked_pdu, Direction.REQUEST), parse_pdu(pdu, Direction.RESPONSE)
    problem = answered.problem or mismatch(asked, answered) or "its form is wrong"
    if pdu and pdu[0] & EXCEPTION_BIT:
        problem = f"an exception of {len(pdu)} bytes, where one has 2"
    else:
        if transaction.function in _COUNTED_ANSWERS and len(pdu) > 1:
            return "MB-202", problem
        if transaction.function in _ECHOES and pdu_length(pdu, Direction.RESPONSE) == len(pdu):
            return "MB-201", problem
    return "MB-203", problem


def padding_of(transaction: Transaction) -> tuple[int, int] | None:
    """The last byte of bits whose padding is not 0, and how many of its bits count."""
    used = (transaction.quantity or 0) % 8
    if not used:
        return None
    if transaction.function == _WRITE_BITS:
        pdu = _pdu(transaction, transaction.request_raw)
    elif transaction.outcome is Outcome.OK:
        pdu = _pdu(transaction, transaction.response_raw)
    else:
        return None
    return (pdu[-1], used) if len(pdu) > 2 and pdu[-1] >> used else None


def _pdu(transaction: Transaction, raw: bytes | None) -> bytes:
    """The PDU of an ADU; empty where there is none, or none that can be read."""
    return whole_pdu(transaction.transport, raw) or b""

"""Makes findings from the finding codes of transactions, with figures in their messages."""

# naming.py has put the codes of the findings into the transactions. `mbtool check` names every
# transaction again before it checks them, so that today's rules also apply to a log from an older
# version, or to a log without the slave's profile.

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding, transaction_finding
from mbtool.devices.checking.rules import DeviceCode
from mbtool.devices.profile_checks import (
    Ranges,
    finding_text,
    request_data,
    value_ranges,
    values_outside,
    written_by_17h,
)
from mbtool.devices.references import is_neutral
from mbtool.devices.response_checks import right_exceptions
from mbtool.devices.standard_checks import padding_of, request_form, response_form
from mbtool.modbus.functions import (
    FUNCTIONS,
    MASK_WRITE_REGISTER,
    READ_WRITE_REGISTERS,
    TABLE_FUNCTIONS,
    WRITE_LIMIT_17H,
    short_name,
)
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.tables import ADDRESSES

if TYPE_CHECKING:
    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction

_REQUEST_FORM = frozenset(("MB-101", "MB-102", "MB-103"))
_RESPONSE_FORM = frozenset(("MB-201", "MB-202", "MB-203"))
_PADDING = frozenset(("MB-105", "MB-204"))
_READS_OR_WRITES = TABLE_FUNCTIONS - {MASK_WRITE_REGISTER, READ_WRITE_REGISTERS}
"""Functions that either read or write values: all except 16H (mask write) and 17H (does both)."""


class TransactionRules:
    """Turns the finding codes of transactions into findings.

    Caches the ranges of values that each profile allows, by the profile's name.
    """

    def __init__(self) -> None:
        self._ranges: dict[str, Ranges] = {}

    def check(self, transaction: NamedTransaction, profile: Profile | None) -> Iterator[Finding]:
        """Give a `Finding` for each finding code in a transaction.

        `profile` is the profile by which the transaction was named; None if the slave has none.
        """
        for code in transaction.findings:
            yield transaction_finding(code, transaction, self._message(code, transaction, profile))

    def _message(self, code: str, transaction: NamedTransaction, profile: Profile | None) -> str:
        parsed = DeviceCode.parse(code)
        if parsed is not None:
            text = finding_text(code, profile)
            return self._manual_message(parsed.rule.code, text, transaction, profile)
        if code in _REQUEST_FORM:
            return f"{request_text(transaction)}: {request_form(transaction)[1]}"
        if code in _RESPONSE_FORM:
            broken = response_form(transaction)
            return f"answer to {request_text(transaction)}: {broken[1] if broken else 'its form'}"
        if code in _PADDING:
            padding = padding_of(transaction)
            if padding is not None:
                byte, used = padding
                bits = "bit counts" if used == 1 else "bits count"
                last = f"the last byte is {byte:02X}H, of which {used} {bits}"
                return f"{request_text(transaction)}: {last}"
        if code == "MB-104":
            return f"{request_text(transaction)}: {_wrong_quantity(transaction)}"
        if code == "MB-106":
            return f"{request_text(transaction)}: {_range_too_long(transaction)}"
        if code == "MB-108":
            return f"{request_text(transaction)}: unit {transaction.unit}, 247 is the last"
        if code == "MB-109":
            return f"a request with function {transaction.function:02X}H, which is reserved"
        if code == "MB-107":
            return f"a request with function {transaction.function:02X}H"
        return f"{request_text(transaction)}: {finding_text(code, profile)}"

    def _manual_message(
        self, letter: str, text: str, transaction: NamedTransaction, profile: Profile | None
    ) -> str:
        """Return the message of a finding about a rule in the device's manual.

        `letter` is the kind of rule, such as Q; `text` says what the manual demands: `limit is
        100`. `profile` is the slave's; None if it has none.
        """
        if letter == "F":
            return text
        if letter == "Q":
            return f"{request_text(transaction)}: {_quantities(transaction)}, {text}"
        if letter == "L":
            return f"{request_text(transaction)}: {_quantities(transaction)}, {text}"
        if letter == "U":
            return f"{request_text(transaction)} of unit {transaction.unit}: {text}"
        if letter == "C" and profile is not None:
            return f"{request_text(transaction)}: {_wrong_exception(transaction, profile)}"
        if letter in ("R", "M"):
            pdu = whole_pdu(transaction.transport, transaction.response_raw) or b""
            data = pdu.hex(" ").upper()
            return f"answer to {request_text(transaction)}: {data}, {text}"
        if letter == "D":
            data = (request_data(transaction) or b"").hex(" ").upper() or "none"
            return f"{request_text(transaction)}: data {data}, {text}"
        if letter == "V" and profile is not None:
            return f"{request_text(transaction)}: {self._values_outside(transaction, profile)}"
        return f"{request_text(transaction)}: {text}"

    def _values_outside(self, transaction: NamedTransaction, profile: Profile) -> str:
        ranges = self._ranges.get(profile.name)
        if ranges is None:
            ranges = self._ranges[profile.name] = value_ranges(profile)
        phrases = []
        for point in values_outside(ranges, transaction.written_points):
            least, greatest = ranges[point.name]
            if least is None or greatest is None:
                limits = f"up to {greatest}" if least is None else f"from {least} on"
            else:
                limits = f"{least}..{greatest}"
            phrases.append(f"{point.name} {point.text}, the range is {limits}")
        return "; ".join(phrases)


def request_text(transaction: NamedTransaction) -> str:
    """Describe a request in a few words: `write registers HR400001..400110`."""
    function = transaction.function
    name = short_name(function, transaction.function_name)
    if not transaction.reference:
        return name
    if function in _READS_OR_WRITES and is_neutral(transaction.reference):
        name = "write" if FUNCTIONS[function].writes else "read"  # The reference names the table.
    return f"{name} {transaction.reference}"


def _wrong_exception(transaction: NamedTransaction, profile: Profile) -> str:
    given = transaction.exception or 0
    right = right_exceptions(profile, transaction, transaction.findings)
    stated = " or ".join(f"{code:02X} ({profile.exception_name(code)})" for code in right)
    stated = f"the manual has {stated}" if right else "nothing is wrong with the request"
    return f"exception {given:02X} ({profile.exception_name(given)}), but {stated}"


def _quantities(transaction: NamedTransaction) -> str:
    if transaction.write_address is None:
        return f"quantity {transaction.quantity}"
    return f"reads {transaction.quantity}, writes {_written_quantity(transaction)}"


def _wrong_quantity(transaction: NamedTransaction) -> str:
    known = FUNCTIONS.get(transaction.function)
    quantity = transaction.quantity
    if known is not None and quantity is not None and not 1 <= quantity <= known.limit:
        return f"quantity {quantity}, the standard allows 1 to {known.limit}"
    written = _written_quantity(transaction)
    return f"writes {written} registers, the standard allows 1 to {WRITE_LIMIT_17H}"


def _written_quantity(transaction: NamedTransaction) -> int:
    """Number of registers that a request with function 17H writes; 0 for another function."""
    return (written_by_17h(transaction) or (0, 0))[1]


def _range_too_long(transaction: NamedTransaction) -> str:
    address, quantity = transaction.address or 0, transaction.quantity or 0
    if address + quantity <= ADDRESSES:
        address, quantity = written_by_17h(transaction) or (0, 0)
    return f"{quantity} from {address:04X}H on, the last address is FFFFH"

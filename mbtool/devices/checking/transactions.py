"""Findings that one transaction shows by itself, with its figures."""

# The codes are those that naming puts into a transaction. They are worked out anew, so that a log
# that an older edition wrote, or that has no profile for a slave, is held against today's rules.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding, found
from mbtool.devices.checking.rules import DeviceCode
from mbtool.devices.profile_checks import finding_text, request_data, value_ranges, values_outside
from mbtool.devices.references import is_neutral
from mbtool.devices.standard_checks import ADDRESSES, answer_form, padding_of, request_form
from mbtool.modbus.functions import FUNCTIONS, WRITE_LIMIT_17H, short_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.devices.profile_checks import Ranges

_FORMS_OF_REQUESTS = frozenset(("MB-101", "MB-102", "MB-103"))
_FORMS_OF_ANSWERS = frozenset(("MB-201", "MB-202", "MB-203"))
_PLAIN = frozenset((0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F, 0x10))
"""Functions that only read or only write values."""
_PADDING = frozenset(("MB-105", "MB-204"))


class TransactionRules:
    """Puts the codes of transactions into words. Keeps the ranges of each profile it has met."""

    def __init__(self) -> None:
        self._ranges: dict[str, Ranges] = {}

    def check(self, transaction: NamedTransaction, profile: Profile | None) -> Iterator[Finding]:
        """`profile` is the one that the transaction was named by."""
        for code in transaction.findings:
            yield found(code, transaction, self._message(code, transaction, profile))

    def _message(self, code: str, transaction: NamedTransaction, profile: Profile | None) -> str:
        parsed = DeviceCode.parse(code)
        if parsed is not None:
            return self._by_manual(
                parsed.rule.code, finding_text(code, profile), transaction, profile
            )
        if code in _FORMS_OF_REQUESTS:
            return f"{asked_for(transaction)}: {request_form(transaction)[1]}"
        if code in _FORMS_OF_ANSWERS:
            broken = answer_form(transaction)
            return f"answer to {asked_for(transaction)}: {broken[1] if broken else 'its form'}"
        if code in _PADDING:
            padding = padding_of(transaction)
            if padding is not None:
                byte, used = padding
                bits = "bit counts" if used == 1 else "bits count"
                last = f"the last byte is {byte:02X}H, of which {used} {bits}"
                return f"{asked_for(transaction)}: {last}"
        if code == "MB-104":
            return f"{asked_for(transaction)}: {_wrong_quantity(transaction)}"
        if code == "MB-106":
            return f"{asked_for(transaction)}: {_beyond(transaction)}"
        if code == "MB-107":
            return f"a request with function {transaction.function:02X}H"
        return f"{asked_for(transaction)}: {finding_text(code, profile)}"

    def _by_manual(
        self, letter: str, text: str, transaction: NamedTransaction, profile: Profile | None
    ) -> str:
        if letter == "F":
            return text
        if letter == "Q":
            return f"{asked_for(transaction)}: {_quantities(transaction)}, {text}"
        if letter == "D":
            data = (request_data(transaction) or b"").hex(" ").upper() or "none"
            return f"{asked_for(transaction)}: data {data}, {text}"
        if letter == "V" and profile is not None:
            return f"{asked_for(transaction)}: {self._outside(transaction, profile)}"
        return f"{asked_for(transaction)}: {text}"

    def _outside(self, transaction: NamedTransaction, profile: Profile) -> str:
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


def asked_for(transaction: NamedTransaction) -> str:
    """What a transaction asks, in a few words: `write registers HR400001..400110`."""
    function = transaction.function
    name = short_name(function, transaction.function_name)
    if not transaction.reference:
        return name
    if function in _PLAIN and is_neutral(transaction.reference):
        name = "write" if FUNCTIONS[function].writes else "read"  # The reference names the table.
    return f"{name} {transaction.reference}"


def _quantities(transaction: NamedTransaction) -> str:
    if transaction.write_address is None:
        return f"quantity {transaction.quantity}"
    return f"reads {transaction.quantity}, writes {len(transaction.request_values or ())}"


def _wrong_quantity(transaction: NamedTransaction) -> str:
    known = FUNCTIONS.get(transaction.function)
    quantity = transaction.quantity
    if known is not None and quantity is not None and not 1 <= quantity <= known.limit:
        return f"quantity {quantity}, the standard allows 1 to {known.limit}"
    written = len(transaction.request_values or ())
    return f"writes {written} registers, the standard allows 1 to {WRITE_LIMIT_17H}"


def _beyond(transaction: NamedTransaction) -> str:
    address, quantity = transaction.address or 0, transaction.quantity or 0
    if address + quantity <= ADDRESSES:
        address, quantity = transaction.write_address or 0, len(transaction.request_values or ())
    return f"{quantity} from {address:04X}H on, the last address is FFFFH"

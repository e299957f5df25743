"""Checks a transaction against the profile of its device; the results are finding codes."""

# standard_checks.py checks a transaction against the standard, and checking/ checks several
# transactions together. checking/rules.py has the table of all rules and explains the codes.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import msgspec

from mbtool.core.limits import LAST_UNIT
from mbtool.devices.block_reads import can_be_read
from mbtool.devices.checking.rules import DeviceCode, rule_of
from mbtool.devices.standard_checks import is_quantity_wrong, request_codes
from mbtool.devices.values import point_instances
from mbtool.modbus.functions import FUNCTIONS, exception_name, function_name
from mbtool.modbus.pdu import whole_pdu

if TYPE_CHECKING:
    from mbtool.devices.model import FunctionRule, Point, Profile
    from mbtool.devices.named_transaction import PointValue
    from mbtool.modbus.tables import Table
    from mbtool.modbus.transaction import Transaction

_WRITE_QUANTITY = slice(7, 9)
"""The slice of a PDU that has the quantity to write, in a request with function 17H."""

Ranges = dict[str, tuple[float | None, float | None]]
"""By the name of a point: the least and the greatest value that the device's manual allows; None
where there is no limit."""


def finding_text(code: str, profile: Profile | None = None) -> str:
    """Describe what a finding code means, in a few words for a message.

    If `profile` is not None, the text has the profile's figures: `limit is 100`.
    """
    parsed = DeviceCode.parse(code)
    if parsed is None:
        rule = rule_of(code)
        return code if rule is None else rule.meaning[0].lower() + rule.meaning[1:].rstrip(".")
    number = parsed.number
    function = FUNCTIONS.get(number)
    match parsed.rule.code:
        case "F":
            return f"the device has no {function_name(number)}"
        case "Q":
            return _limit_text(profile.rule(number) if profile is not None else None)
        case "L":
            limit = profile.rule(number) if profile is not None else None
            return f"{_limit_text(limit)}, which is doubtful"
        case "U":
            last = profile.last_unit if profile is not None else None
            return "the device cannot have this unit" if last is None else f"units are 1 to {last}"
        case "C":
            return f"exception {number:02X} is for another cause"
        case "R":
            own = profile.rule(number) if profile is not None else None
            return "the response has another form" if own is None else _form_text(own)
        case "M":
            return "the manual does not list this code"
        case "A":
            verb = "write" if function is not None and function.writes else "read"
            return f"not an address that one can {verb}"
        case "W":
            return "one may only read there"
        case "V":
            return "a value outside its range"
        case "D":
            fixed = profile.rule(number) if profile is not None else None
            data = f" as {fixed.data.upper()}" if fixed is not None and fixed.data else ""
            return f"the manual fixes them{data}"
        case _:
            name = exception_name(number) if profile is None else profile.exception_name(number)
            # If the code has no name, `name` is `exception NN`, which the text already says.
            named = "" if name.startswith("exception ") else f" ({name})"
            return f"exception {number:02X}{named} is not documented"


def request_findings(profile: Profile | None, transaction: Transaction) -> Iterator[str]:
    """Yield the finding codes for the function, the addresses and the quantities of a request.

    If `profile` is None, only the standard's rules are checked.
    """
    function = transaction.function
    written = written_by_17h(transaction)
    standard = list(request_codes(function, transaction.address, transaction.quantity, written))
    if profile is None:
        yield from standard
        return
    prefix = finding_prefix(profile)
    rule = profile.rule(function)
    if rule is None:
        yield f"{prefix}-F{function}"
        return
    if _is_quantity_wrong(rule, transaction, written):
        is_doubtful = rule.doubtful and not any(code == "MB-104" for code in standard)
        yield f"{prefix}-{'L' if is_doubtful else 'Q'}{function}"
    elif rule.limit is None:
        # Leave out MB-106, a range beyond FFFFH, because such a range is also outside the device's
        # areas and gets a code with the letter A.
        yield from (code for code in standard if code != "MB-106")
    letter = _address_letter(profile, transaction, written)
    if letter is not None:
        yield f"{prefix}-{letter}{function}"


def exception_finding_code(profile: Profile, function: int, exception: int) -> str | None:
    """Return the finding code if the device's manual does not list the exception code `exception`
    for a function; None if it lists it.
    """
    if exception in profile.documented_exceptions(function):
        return None
    return f"{finding_prefix(profile)}-E{exception}"


def value_ranges(profile: Profile) -> Ranges:
    """Return the range of values that the manual states, for each point that has one and can be
    written.
    """
    return {
        instance.name: (point.minimum, point.maximum)
        for point in profile.points
        if point.minimum is not None or point.maximum is not None
        for instance in point_instances(_with_only(profile, point), point.table, writing=True)
    }


def values_outside(ranges: Ranges, points: Sequence[PointValue]) -> list[PointValue]:
    """The values among `points` that are outside the range of their point."""
    return [point for point in points if _is_outside(point.value, ranges.get(point.name))]


def value_finding_code(profile: Profile, function: int) -> str:
    """Return the finding code for a value that a request with this function writes, outside the
    range in the manual.
    """
    return f"{finding_prefix(profile)}-V{function}"


def fixed_data(profile: Profile) -> dict[int, bytes]:
    """Return, by function code, the bytes that must follow the function code of a request.

    Only functions for which the manual fixes such bytes are included.
    """
    return {
        int(code, 16): bytes.fromhex(rule.data)
        for code, rule in profile.functions.items()
        if rule.data is not None
    }


def has_other_data(transaction: Transaction, fixed: bytes) -> bool:
    """True if the manual demands that the bytes after a request's function code begin with `fixed`,
    and those of this request do not.
    """
    data = request_data(transaction)
    return data is not None and not data.startswith(fixed)


def request_data(transaction: Transaction) -> bytes | None:
    """The bytes after the function code of a request; None if there is no readable request."""
    pdu = whole_pdu(transaction.transport, transaction.request_raw)
    return None if pdu is None else pdu[1:]


def data_finding_code(profile: Profile, function: int) -> str:
    """Return the finding code for a request whose bytes after the function code differ from those
    that the manual fixes.
    """
    return f"{finding_prefix(profile)}-D{function}"


def written_by_17h(transaction: Transaction) -> tuple[int, int] | None:
    """Return the first address and the quantity of registers that a request with function 17H
    writes.

    None for other functions. The quantity comes from the request's quantity field, even if the
    request has another number of values.
    """
    if transaction.write_address is None:
        return None
    if transaction.write_quantity is not None:
        return transaction.write_address, transaction.write_quantity
    # Older logs have no write_quantity.
    quantity = len(transaction.request_values or ())
    pdu = whole_pdu(transaction.transport, transaction.request_raw)
    if pdu is not None and len(pdu) >= _WRITE_QUANTITY.stop:
        quantity = int.from_bytes(pdu[_WRITE_QUANTITY])
    return transaction.write_address, quantity


def unit_finding_code(profile: Profile | None, unit: int) -> str:
    """Return the finding code for a unit number that a slave with this profile cannot have on a
    serial line. If `profile` is None, the code is that of the standard's rule.
    """
    if profile is None or profile.last_unit is None or unit > LAST_UNIT:
        return "MB-108"
    return f"{finding_prefix(profile)}-U{unit}"


def finding_prefix(profile: Profile) -> str:
    return profile.finding_prefix or profile.name.upper()


def _is_quantity_wrong(
    rule: FunctionRule, transaction: Transaction, written: tuple[int, int] | None
) -> bool:
    """True if a quantity in a request is 0, or above the limit that the manual states for it.

    `written` is the first address and the quantity that function 17H writes; otherwise None.
    """
    quantity = transaction.quantity
    if rule.limit is not None and quantity is not None and not 1 <= quantity <= rule.limit:
        return True
    if rule.write_limit is not None and written is not None:
        return not 1 <= written[1] <= rule.write_limit
    return rule.limit is not None and is_quantity_wrong(transaction.function, None, written)


def _limit_text(rule: FunctionRule | None) -> str:
    if rule is None or (rule.limit is None and rule.write_limit is None):
        return "the quantity is not allowed"
    if rule.write_limit is None:
        return f"limit is {rule.limit}"
    if rule.limit is None:
        return f"at most {rule.write_limit} are written"
    return f"at most {rule.limit} are read and {rule.write_limit} written"


def _form_text(rule: FunctionRule) -> str:
    """Describe the form of the response that the manual states, for a message."""
    if not rule.answers:
        return "the manual states no response"
    return "the manual states two bytes" if rule.answer is not None else "it is not as sent"


def _address_letter(
    profile: Profile, transaction: Transaction, written: tuple[int, int] | None
) -> str | None:
    """Return the letter of the finding about a request's addresses; None if there is no finding.

    A means that the device does not have the addresses, W that a master can only read them.
    `written` is the first address and the quantity that function 17H writes; otherwise None.
    """
    known = FUNCTIONS.get(transaction.function)
    if known is None or known.table is None or transaction.address is None:
        return None
    first = transaction.address
    span = range(first, first + max(transaction.quantity or 1, 1))
    if written is not None:
        if not can_be_read(profile, known.table, span):
            return "A"
        span = range(written[0], written[0] + max(written[1], 1))
    elif not known.writes:
        return None if can_be_read(profile, known.table, span) else "A"
    if profile.allows(known.table, span, writing=True):
        return "W" if holds_read_only_point(profile, known.table, span) else None
    return "W" if profile.allows(known.table, span) else "A"


def holds_read_only_point(profile: Profile, table: Table, span: range) -> bool:
    """True if a range of addresses contains a point that a master can only read."""
    points = [point for point in profile.points if point.table is table]
    read_only = {
        address
        for point in points
        if not point.allows(writing=True)
        for address in point.all_addresses
        if address in span
    }
    for point in points if read_only else ():
        if point.allows(writing=True):
            read_only -= point.all_addresses
    return bool(read_only)


def _with_only(profile: Profile, point: Point) -> Profile:
    return msgspec.structs.replace(profile, points=[point])


def _is_outside(value: float | None, limits: tuple[float | None, float | None] | None) -> bool:
    if limits is None or value is None:
        return False
    least, greatest = limits
    return (least is not None and value < least) or (greatest is not None and value > greatest)

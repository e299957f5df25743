"""Rules of a device that one transaction can break, with stable codes."""

# A code is the profile's prefix, a letter for the rule and a number: FT1A-Q16. The number is the
# function code in decimal (Q16 is function 10H, "FC16" in the manuals), for E the exception code.
# The prefix tells whose manual is broken, the letter stays when a limit changes, and the number
# makes each of them something to filter for.

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mbtool.modbus.functions import FUNCTIONS, exception_name, function_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile
    from mbtool.modbus.transaction import Transaction

RULES = {
    "F": "The device's manual does not list the function.",
    "Q": "The quantity is 0 or more than the device's manual allows for the function.",
    "A": "The function addresses what the device's manual does not have, or does not let it write.",
    "E": "The device gave an exception code that its manual does not list.",
}
"""What each letter stands for, for docs/devices.md."""

_CODE = re.compile(r"(?P<prefix>.+)-(?P<letter>[FQAE])(?P<number>\d{1,3})", re.ASCII)


def finding_text(code: str, profile: Profile | None = None) -> str:
    """A code in words, with the figures of its profile where that is given: `limit is 100`."""
    match = _CODE.fullmatch(code)
    if match is None:
        return code
    number = int(match["number"])
    function = FUNCTIONS.get(number)
    match match["letter"]:
        case "F":
            return f"the device has no {function_name(number)}"
        case "Q":
            rule = profile.rule(number) if profile is not None else None
            return (
                f"limit is {rule.limit}" if rule and rule.limit else "the quantity is not allowed"
            )
        case "A":
            verb = "write" if function is not None and function.writes else "read"
            return f"not an address that one can {verb}"
        case _:
            return f"exception {number:02X} ({exception_name(number)}) is not documented"


def request_findings(profile: Profile, transaction: Transaction) -> Iterator[str]:
    """Codes for what a request asks of its device."""
    prefix = finding_prefix(profile)
    function, quantity = transaction.function, transaction.quantity
    rule = profile.rule(function)
    if rule is None:
        yield f"{prefix}-F{function}"
        return
    if rule.limit is not None and quantity is not None and not 1 <= quantity <= rule.limit:
        yield f"{prefix}-Q{function}"
    if not _may_reach(profile, transaction):
        yield f"{prefix}-A{function}"


def exception_finding(profile: Profile, exception: int) -> str | None:
    """The code for an exception that the device's manual does not list."""
    if exception in profile.exceptions.documented:
        return None
    return f"{finding_prefix(profile)}-E{exception}"


def finding_prefix(profile: Profile) -> str:
    return profile.finding_prefix or profile.name.upper()


def _may_reach(profile: Profile, transaction: Transaction) -> bool:
    """Whether the device has every address that is asked for, and lets it be written."""
    known = FUNCTIONS.get(transaction.function)
    if known is None or known.table is None or transaction.address is None:
        return True
    first = transaction.address
    span = range(first, first + max(transaction.quantity or 1, 1))
    if transaction.write_address is None:
        return profile.allows(known.table, span, writing=known.writes)
    first = transaction.write_address
    written = range(first, first + max(len(transaction.request_values or ()), 1))
    return profile.allows(known.table, span) and profile.allows(known.table, written, writing=True)

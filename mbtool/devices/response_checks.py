"""Checks a slave's response against the profile of its device; the results are finding codes."""

# profile_checks.py checks the request. An exception code is wrong in two cases:
#
#     the request has faults, and the manual states the code for each    any other code is wrong
#     the request has none, and every address of the areas exists        any refusal is wrong
#
# There is no finding if the manual leaves the code open (Exceptions.causes,
# Profile.complete_areas). There is none either for exception codes other than those for a wrong
# function, address or value: their reasons may not be visible in a capture.

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.devices.model import AnswerWord, ExceptionCause, FunctionRule, Profile
from mbtool.devices.profile_checks import finding_prefix
from mbtool.modbus.functions import TABLE_FUNCTIONS
from mbtool.modbus.pdu import parse_pdu, whole_pdu

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

_CAUSES = {
    "F": ExceptionCause.FUNCTION,
    "Q": ExceptionCause.VALUE,
    "D": ExceptionCause.VALUE,
    "A": ExceptionCause.ADDRESS,
    "W": ExceptionCause.ADDRESS,
    "MB-101": ExceptionCause.VALUE,
    "MB-102": ExceptionCause.VALUE,
    "MB-103": ExceptionCause.VALUE,
    "MB-104": ExceptionCause.VALUE,
    "MB-105": ExceptionCause.VALUE,
}
"""The reason for which a device refuses a request that has a finding. The key is the code of the
finding, or only its letter if the finding is about the device's manual."""
_WORD_BYTES = 3


def response_findings(
    profile: Profile, transaction: Transaction, request_codes: Collection[str]
) -> Iterator[str]:
    """Yield the finding codes of a response. `request_codes` are the finding codes of its
    request.
    """
    prefix = finding_prefix(profile)
    if transaction.exception is not None:
        if is_wrong_exception(profile, transaction, request_codes):
            yield f"{prefix}-C{transaction.exception}"
        return
    rule = profile.rule(transaction.function)
    pdu = whole_pdu(transaction.transport, transaction.response_raw)
    if rule is None or pdu is None:
        return
    if _has_other_form(rule, pdu, whole_pdu(transaction.transport, transaction.request_raw)):
        yield f"{prefix}-R{transaction.function}"
    elif rule.answer is not None and _is_unknown(rule.answer, pdu):
        yield f"{prefix}-M{transaction.function}"


def is_wrong_exception(
    profile: Profile, transaction: Transaction, request_codes: Collection[str]
) -> bool:
    """True if the device should have responded with another exception code, or without an
    exception.

    `request_codes` are the finding codes of the request.
    """
    given, function = transaction.exception, transaction.function
    codes = {cause: _code(profile, cause, function) for cause in ExceptionCause}
    if given not in codes.values() or given not in profile.documented_exceptions(function):
        return False
    causes = causes_in(profile, request_codes)
    own = profile.rule(function)
    if not causes and own is not None and own.data is not None:
        # The profile states every byte of the request, so a device has no reason to refuse it. The
        # function exists, and the request has no address, so the codes for these causes are wrong.
        # If the device responds only to a failed request (`answers` is false), the manual need not
        # state the code for the failure. So the code for a wrong value is accepted then.
        return own.answers or given != codes[ExceptionCause.VALUE]
    if not causes:
        return profile.complete_areas and _is_well_formed(transaction)
    is_stated = causes <= set(profile.exceptions.causes)
    return is_stated and given not in {codes[cause] for cause in causes}


def causes_in(profile: Profile, request_codes: Collection[str]) -> set[ExceptionCause]:
    """Return the reasons for which a device refuses a request with these finding codes."""
    prefix = f"{finding_prefix(profile)}-"
    keys = [
        code.removeprefix(prefix)[0] if code.startswith(prefix) else code for code in request_codes
    ]
    return {_CAUSES[key] for key in keys if key in _CAUSES}


def right_exceptions(
    profile: Profile, transaction: Transaction, request_codes: Collection[str]
) -> list[int]:
    """The exception codes that the manual states for a request; empty for a correct request.

    `request_codes` are the finding codes of the request.
    """
    causes = causes_in(profile, request_codes)
    return sorted({_code(profile, cause, transaction.function) for cause in causes})


def _code(profile: Profile, cause: ExceptionCause, function: int) -> int:
    if cause is ExceptionCause.VALUE:
        return profile.value_exception(function)
    if cause is ExceptionCause.ADDRESS:
        return profile.exceptions.address
    return profile.exceptions.function


def _is_well_formed(transaction: Transaction) -> bool:
    """True if the request is well-formed and has a function that reads or writes a table.

    A device may refuse any other function for reasons that the profile does not know.
    """
    request = whole_pdu(transaction.transport, transaction.request_raw)
    if request is None or transaction.function not in TABLE_FUNCTIONS:
        return False
    return parse_pdu(request, Direction.REQUEST).problem is None


def _is_unknown(answer: AnswerWord, pdu: bytes) -> bool:
    return bool(answer.texts) and int.from_bytes(pdu[1:]) not in answer.texts


def _has_other_form(rule: FunctionRule, pdu: bytes, request: bytes | None) -> bool:
    if not rule.answers:
        return True
    if rule.answer is not None:
        return len(pdu) != _WORD_BYTES
    return rule.echoes and request is not None and pdu != request

"""Writes the cells of a table of transactions: request, result, findings and time."""

# The text of a read, for example, has function, reference and values:
#
#     03 read HR400001..400002 -> 4660, 22136

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.core.moments import counted
from mbtool.devices import describe_points, describe_written, finding_text
from mbtool.modbus import FUNCTIONS, Outcome, Verdict, exception_name, short_name, whole_pdu
from mbtool.modbus.functions import MASK_WRITE_REGISTER, READ_WRITE_REGISTERS
from mbtool.views.changed_points import PointsRead, is_number

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, PointValue, Profile

MANY_BITS = 8
"""If a request or response has more bits than this, a cell shows them in groups of eight bits."""
GROUP = 8
FOLDED = 4
"""If at least this many equal values follow each other, a cell shows the value once, with their
number: `0 x24`."""

MAX_RAW = 16
"""A cell shows at most this many of the bytes that belong to an event, such as skipped bytes."""

ARROW = " -> "
"""Separates the request from its result in a cell: `03 read HR400001 -> 4660`."""
_SHORT_EXCEPTIONS = {
    0x02: "illegal address",
    0x03: "illegal value",
    0x04: "device failure",
    0x06: "device busy",
    0x0A: "gateway: no path",
    0x0B: "gateway: no answer",
}
"""Short names of exception codes, for a narrow terminal. The standard's names are illegal data
address, illegal data value, server device failure, server device busy, gateway path unavailable,
gateway target failed to respond."""

_VERBS = {
    code: "write" if one.writes else "read"
    for code, one in FUNCTIONS.items()
    if one.table is not None
} | {MASK_WRITE_REGISTER: "mask write", READ_WRITE_REGISTERS: "read"}
"""By function code: the word that a cell shows before the reference, such as `read`."""


def transaction_text(
    transaction: NamedTransaction,
    points: Sequence[PointValue] | None = None,
    *,
    in_hex: bool = False,
) -> str:
    """Return the request and its result: `03 read HR400001..400002 -> 4660, 22136`.

    `points` are the named values that the response contains, in the order to show them; by default
    the transaction's own order. With `in_hex`, values are shown as manuals write them (1234H) and
    without the names of points.
    """
    result = result_text(transaction, points, in_hex=in_hex)
    return _joined(transaction, result, in_hex=in_hex)


def short_transaction_text(
    transaction: NamedTransaction, points: PointsRead, *, in_hex: bool = False
) -> str:
    """Return the request and its result in fewer words than transaction_text, for a narrow table.

    Points (named values) that did not change since the last reading are only counted. The
    standard's exceptions get the short names of _SHORT_EXCEPTIONS.
    """
    if transaction.exception is not None:
        result = short_result(transaction, in_hex=in_hex)
    elif in_hex or len(points.fresh) == len(points.every) or transaction.outcome is not Outcome.OK:
        result = result_text(transaction, points.every, in_hex=in_hex)
    else:
        result = _fresh_text(points)
    return _joined(transaction, result, in_hex=in_hex)


def short_result(transaction: NamedTransaction, *, in_hex: bool = False) -> str:
    """Return the result of a transaction with the short names of the standard's exceptions."""
    code, name = transaction.exception, transaction.exception_name
    result = result_text(transaction, in_hex=in_hex)
    if code is not None and name == exception_name(code):
        result = result.removesuffix(name) + short_exception(code)
    return result.removeprefix(_EXCEPTION)


def short_exception(code: int) -> str:
    """Return a short name of an exception code, for a narrow terminal; the standard's if it has
    none.
    """
    return _SHORT_EXCEPTIONS.get(code, exception_name(code))


def _fresh_text(points: PointsRead) -> str:
    """List the points (named values) that changed: `CH1 12000, CH3 5; 6 others as before`.

    Unchanged points are only counted.
    """
    if not points.fresh:
        return "as before"
    names = [point.name.partition(" ") for point in points.every]
    is_one_series = len({subject for _, _, subject in names}) == 1
    if is_one_series and not points.has_unseen and all(map(is_number, points.fresh)):
        labels = (point.name.partition(" ")[0] for point in points.fresh)
        pairs = zip(labels, points.fresh, strict=True)
        text = ", ".join(f"{label} {point.text}" for label, point in pairs)
    else:
        text = "; ".join(describe_points(points.fresh))
    kept = len(points.every) - len(points.fresh)
    return f"{text}; {counted(kept, 'other')} as before"


def _joined(transaction: NamedTransaction, result: str, *, in_hex: bool) -> str:
    code = transaction.function
    what = what_text(transaction, in_hex=in_hex)
    if transaction.reference and code in _VERBS:
        text = f"{code:02X} {_VERBS[code]} {what}"
    else:
        text = f"{function_text(transaction)} {what}".rstrip()
    if result == _DONE and code in _VERBS:
        return text
    return f"{text}{ARROW}{result.removeprefix(_EXCEPTION)}"


def event_text(event: WireEvent) -> str:
    """Return the kind of a wire event, its message and its first bytes in hexadecimal."""
    raw = event.raw[:MAX_RAW].hex(" ")
    more = " ..." if len(event.raw) > MAX_RAW else ""
    text = f"{event.kind.value}: {event.message}" if event.message else event.kind.value
    return f"{text}: {raw}{more}" if raw else text


def function_text(transaction: NamedTransaction) -> str:
    """Return the function code in hexadecimal, and the vendor's or the standard's name of it."""
    name = short_name(transaction.function, transaction.function_name)
    if transaction.function not in FUNCTIONS and name.startswith("function "):
        name = "unknown function"
    return f"{transaction.function:02X} {name}"


def what_text(transaction: NamedTransaction, *, in_hex: bool = False) -> str:
    """Return the reference of a request and the values that it writes: `HR400001 := 5`.

    It ends in `(asked 3x)` if it got a response and two equal requests before it had none, in
    `(3 in a row)` if it got none either, and in `(ambiguous)` if its direction or its pairing
    with the response is ambiguous.
    """
    function = FUNCTIONS.get(transaction.function)
    writes = function is not None and function.writes
    text = transaction.reference or ""
    if writes and transaction.written_points and not in_hex:
        text = describe_written(transaction)
    elif writes and transaction.request_values:
        text = f"{text} := {_values(transaction, transaction.request_values, in_hex=in_hex)}"
    elif not text and transaction.sub_function is not None:
        text = f"sub-function {transaction.sub_function:02X}"
    if transaction.retries:
        times = transaction.retries + 1
        is_again = transaction.outcome is Outcome.NO_ANSWER
        text = f"{text} ({times} in a row)" if is_again else f"{text} (asked {times}x)"
    if Verdict.AMBIGUOUS in transaction.verdicts:
        text = f"{text} (ambiguous)"
    return text.strip()


def finding_texts(transaction: NamedTransaction, profile: Profile | None = None) -> list[str]:
    """Return code and text of each finding (broken rule) of a transaction.

    With a profile, the text has the figures of the device's manual.
    """
    return [f"{code} {finding_text(code, profile)}" for code in transaction.findings]


_DONE = "ok"
_EXCEPTION = "exception "


def result_text(
    transaction: NamedTransaction,
    points: Sequence[PointValue] | None = None,
    *,
    in_hex: bool = False,
) -> str:
    """Return the outcome of a transaction, or the values in its response.

    `points` are the named values of the response, by default the transaction's own. With `in_hex`,
    values are shown as 1234H, and without the names of points.
    """
    if transaction.outcome is Outcome.NOT_CAPTURED:
        lacking = _lacking_response(transaction)
        if lacking is not None:
            return lacking
    word = _lacking_request(transaction)
    if transaction.exception is not None:
        name = transaction.exception_name or ""
        text = f"{_EXCEPTION}{transaction.exception:02X}"
        if not name.startswith(text):  # The name of an unknown code has the number in it.
            text = f"{text} {name}".rstrip()
        word = "late:" if transaction.outcome is Outcome.LATE else word
        return text if word is None else f"{word} {text}"
    match transaction.outcome:
        case Outcome.NO_ANSWER:
            return "no answer"
        case Outcome.BROADCAST:
            return "broadcast"
        case Outcome.MALFORMED:
            return "malformed answer"
    values = transaction.response_values
    if word is not None:
        return (
            f"{word} {_values(transaction, values, in_hex=in_hex)}" if values else word.rstrip(":")
        )
    read = transaction.read_points if points is None else points
    is_late = transaction.outcome is Outcome.LATE
    text = _DONE
    if read and not in_hex:
        text = "; ".join(describe_points(read))
    elif values:
        text = _values(transaction, values, in_hex=in_hex)
    elif is_late:
        return "late"
    return f"late: {text}" if is_late else text


def _lacking_response(transaction: NamedTransaction) -> str | None:
    """Return a text that says which part of the response the capture lacks; None if it lacks
    nothing.
    """
    is_cut = Verdict.CUT in transaction.verdicts
    if Verdict.CAPTURE_END in transaction.verdicts:
        return "capture ends before an answer"
    if transaction.response_raw is None:
        return "request cut, no answer captured" if is_cut else "answer not captured"
    is_whole = whole_pdu(transaction.transport, transaction.response_raw) is not None
    return "answer cut" if is_cut and not is_whole else None


def _lacking_request(transaction: NamedTransaction) -> str | None:
    """Return the beginning of the result text if the capture lacks all or part of the request.

    The response still follows it: `request not captured: 4660`. Returns None if the request is
    complete.
    """
    if transaction.outcome is Outcome.UNSOLICITED:
        return "unsolicited"
    if transaction.outcome is not Outcome.NOT_CAPTURED:
        return None
    return "request not captured:" if transaction.request_raw is None else "request cut:"


def values_text(values: Sequence[int], *, bits: bool = False, in_hex: bool = False) -> str:
    """List registers with commas, or bits with spaces; the first value has the lowest address.

    `bits` is True for bits. At least FOLDED equal registers that follow each other, or equal groups
    of eight bits, are shown once with their number: `0 x24`. With `in_hex`, registers are written
    as 1234H.
    """
    if bits and len(values) <= MANY_BITS:
        return " ".join(map(str, values))
    if bits:
        text = "".join(map(str, values))
        return " ".join(_folded(text[at : at + GROUP] for at in range(0, len(text), GROUP)))
    return ", ".join(_folded([f"{one:04X}H" for one in values] if in_hex else map(str, values)))


def _folded(texts: Iterable[str]) -> list[str]:
    texts = [*texts]
    if len(set(texts)) > len(texts) - FOLDED + 1:  # No FOLDED texts are equal.
        return texts
    folded = []
    for text, run in groupby(texts):
        count = len(list(run))
        folded += [f"{text} x{count}"] if count >= FOLDED else [text] * count
    return folded


def _values(transaction: NamedTransaction, values: list[int], *, in_hex: bool) -> str:
    match transaction.function, values:
        case 0x07, [status]:
            return f"status {status:02X}H"
        case 0x0B, [status, events]:
            return f"status {status:04X}H, {events} events"
        case 0x16, [and_mask, or_mask]:
            return f"AND {and_mask:04X}H, OR {or_mask:04X}H"
    function = FUNCTIONS.get(transaction.function)
    bits = function is not None and function.table is not None and function.table.is_bits
    return values_text(values, bits=bits, in_hex=in_hex)

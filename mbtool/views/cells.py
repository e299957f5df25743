"""The cells of the transaction table as text, for terminals, files and the live view."""

#     #   time          link   unit  function         what              result       latency
#     12  09:14:03.201  rs485  1     03 read holding  HR400001..400002  4660, 22136  8.2 ms

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.core.wording import milliseconds
from mbtool.devices import describe_points, describe_written, finding_text
from mbtool.modbus import FUNCTIONS, Outcome, Verdict, short_name

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.devices import NamedTransaction, Profile

MAX_VALUES = 16
"""The most registers that a cell lists. For more, the cell also says how many there are."""

MAX_BITS = 32

MAX_RAW = 16
"""The most bytes of an event that a cell lists."""


@dataclass(frozen=True, slots=True)
class TransactionRow:
    """One line of the transaction table: the texts of its cells."""

    number: str
    time: str
    link: str
    unit: str
    function: str
    what: str
    result: str
    latency: str
    trouble: bool
    """True for failed transactions and unusual events, which are shown in colour."""

    def cells(self) -> tuple[str, ...]:
        return (
            self.number,
            self.time,
            self.link,
            self.unit,
            self.function,
            self.what,
            self.result,
            self.latency,
        )


_EPOCH = date(1970, 1, 1).toordinal()
_DAY_S = 86_400

HEADINGS = ("#", "time", "link", "unit", "function", "what", "result", "latency")


def transaction_row(
    number: int, transaction: NamedTransaction, profile: Profile | None = None
) -> TransactionRow:
    """The row of a transaction. With a profile, its findings have the profile's figures."""
    return TransactionRow(
        number=str(number),
        time=clock_time(transaction.start_ns),
        link=transaction.link,
        unit=str(transaction.unit),
        function=function_text(transaction),
        what=what_text(transaction, profile),
        result=result_text(transaction),
        latency=latency_text(transaction.latency_ns),
        trouble=transaction.outcome not in (Outcome.OK, Outcome.BROADCAST),
    )


def event_row(event: WireEvent) -> TransactionRow:
    """The row of a wire event in the transaction table."""
    return TransactionRow(
        number="",
        time=clock_time(event.ts_ns),
        link=event.link,
        unit="",
        function=event.kind.value,
        what=event.message,
        result=_shortened(event.raw),
        latency="",
        trouble=event.kind not in (EventKind.OPENED, EventKind.CLOSED),
    )


def function_text(transaction: NamedTransaction) -> str:
    """The cell "function": the code in hexadecimal, and the vendor's or the standard's name."""
    name = short_name(transaction.function, transaction.function_name)
    if transaction.function not in FUNCTIONS and name.startswith("function "):
        name = "unknown function"
    return f"{transaction.function:02X} {name}"


def what_text(transaction: NamedTransaction, profile: Profile | None = None) -> str:
    """The cell "what": the reference, the values that a request writes, and the findings."""
    function = FUNCTIONS.get(transaction.function)
    writes = function is not None and function.writes
    text = transaction.reference or ""
    if writes and transaction.written_points:
        text = describe_written(transaction)
    elif writes and transaction.request_values:
        text = f"{text} := {_values(transaction, transaction.request_values)}"
    elif not text and transaction.sub_function is not None:
        text = f"sub-function {transaction.sub_function:02X}"
    if transaction.retries:
        text = f"{text} (retry {transaction.retries})"
    if Verdict.AMBIGUOUS in transaction.verdicts:
        text = f"{text} (ambiguous)"
    for code in transaction.findings:
        text = f"{text}  ! {code} {finding_text(code, profile)}"
    return text.strip()


_WITHOUT_REQUEST = {
    Outcome.UNSOLICITED: "unsolicited",
    Outcome.NOT_CAPTURED: "request not captured:",
}
"""How the result of a response without a request begins."""


def result_text(transaction: NamedTransaction) -> str:
    """The cell "result": the outcome, and the values that a response contains."""
    if transaction.exception is not None:
        name = transaction.exception_name or ""
        text = f"exception {transaction.exception:02X}"
        if not name.startswith(text):  # The name of an unknown code is `exception` and the number.
            text = f"{text} {name}".rstrip()
        word = _WITHOUT_REQUEST.get(transaction.outcome)
        return text if word is None else f"{word} {text}"
    match transaction.outcome:
        case Outcome.NO_ANSWER:
            return "no answer"
        case Outcome.BROADCAST:
            return "broadcast"
        case Outcome.MALFORMED:
            return "malformed answer"
        case Outcome.NOT_CAPTURED if transaction.response_raw is None:
            return "answer not captured"
        case Outcome.UNSOLICITED | Outcome.NOT_CAPTURED as outcome:
            values = transaction.response_values
            word = _WITHOUT_REQUEST[outcome]
            return f"{word} {_values(transaction, values)}" if values else word.rstrip(":")
    if transaction.read_points:
        return "; ".join(describe_points(transaction.read_points))
    values = transaction.response_values
    return _values(transaction, values) if values else "ok"


def values_text(values: list[int], *, bits: bool = False) -> str:
    """List registers with commas, or bits with spaces.

    If there are too many, only the first ones are listed, and how many there are.
    """
    shown = MAX_BITS if bits else MAX_VALUES
    joint = " " if bits else ", "
    text = joint.join(map(str, values[:shown]))
    return text if len(values) <= shown else f"{text}{joint}... ({len(values)} values)"


def latency_text(latency_ns: int | None) -> str:
    """Write a latency in milliseconds, and from 10 s on in seconds; empty for None."""
    if latency_ns is None:
        return ""
    if latency_ns >= 10_000_000_000:
        return f"{latency_ns / 1e9:.1f} s"
    return milliseconds(latency_ns)


def clock_time(ts_ns: int) -> str:
    """Write the time of day in UTC, with milliseconds. Never raises: a capture may have any
    integer.
    """
    seconds, milliseconds = divmod(ts_ns // 1_000_000, 1000)
    minutes, second = divmod(seconds % _DAY_S, 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}.{milliseconds:03d}"


def day(ts_ns: int) -> str:
    """Write the date in UTC; outside the years 1 to 9999, the number of days since 1970."""
    days = ts_ns // (_DAY_S * 1_000_000_000)
    try:
        return date.fromordinal(_EPOCH + days).isoformat()
    except (ValueError, OverflowError):
        return f"day {days}"


def _shortened(raw: bytes) -> str:
    text = raw[:MAX_RAW].hex(" ")
    return text if len(raw) <= MAX_RAW else f"{text} ..."


def _values(transaction: NamedTransaction, values: list[int]) -> str:
    match transaction.function, values:
        case 0x07, [status]:
            return f"status {status:02X}H"
        case 0x0B, [status, events]:
            return f"status {status:04X}H, {events} events"
        case 0x16, [and_mask, or_mask]:
            return f"AND {and_mask:04X}H, OR {or_mask:04X}H"
    function = FUNCTIONS.get(transaction.function)
    bits = function is not None and function.table is not None and function.table.is_bits
    return values_text(values, bits=bits)

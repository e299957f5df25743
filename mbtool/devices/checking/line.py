"""The rules for serial lines: silences, damage, the master's pace, and broadcasts."""

# MB-301, MB-302    a slave responds to a broadcast; the master tries to read with a broadcast
# RTU-101..103      silences: one finding for each unit and kind, with a count
# RTU-104           one finding for a line, in place of RTU-101..103, RTU-301 and RTU-302
#
# A serial adapter may collect bytes and deliver them in blocks. Then many transactions of a line
# seem to have no silence between frames, or silences inside them, and the times say nothing about
# the line. RTU-104 reports that once, in place of all findings about silences. A line needs at
# least MIN_TRANSACTIONS transactions for RTU-104.
#
# A busy computer sometimes reads late, which looks the same: on healthy lines, up to 16 % of the
# transactions had such a silence (measured). A fault of the line affects many transactions of one
# unit. So RTU-101..103 are only reported for a unit if at least MIN_SILENCES of its transactions
# have such a silence, and these are at least the share MIN_SILENCES_SHARE of all its transactions.
# Otherwise a remark tells how many there are.
#
# A capture may begin and end inside a frame, so bytes before the first frame of a line and after
# its last one are no finding.
#
# Memory: some numbers for each line and each of its units (see lru_dict.py).

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, Silence, WireEvent
from mbtool.core.wording import counted, milliseconds
from mbtool.devices.checking.finding import Finding, event_finding, transaction_finding
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import FUNCTIONS, WRITE_ONE
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import SerialFormat
    from mbtool.devices.model import Profile

TURNAROUND_NS = 100_000_000
"""The least silence after a broadcast: the standard calls a turnaround delay of 100 to 200 ms
usual."""
RESPONSE_TO_BROADCAST_NS = 1_000_000_000
"""A response that begins at most this long after a broadcast is a response to the broadcast."""
MIN_TRANSACTIONS = 8
ADAPTER_SHARE = 0.25
"""The share of a line's transactions, 0 to 1, that must be glued or split before the adapter is
said to deliver bytes in blocks. Glued: no silence between frames; split: a silence inside one."""
MIN_SILENCES = 3
MIN_SILENCES_SHARE = 0.2
"""The least share of a unit's transactions, 0 to 1, that must have a wrong silence for a finding.
It is above the 16 % that late reads were measured to cause."""

_SILENCES = {
    Verdict.T1_5_BROKEN: ("RTU-101", "a silence longer than t1.5 inside a frame"),
    Verdict.SPLIT: ("RTU-102", "a silence of t3.5 or longer inside a frame"),
    Verdict.GLUED: ("RTU-103", "less than t3.5 of silence between frames"),
}
_BLOCK_SIGNS = frozenset((Verdict.SPLIT, Verdict.GLUED))
_DIAGNOSTICS = 0x08


@dataclass(slots=True)
class _Cases:
    """All cases of one kind: the first case, and how many there are."""

    first: NamedTransaction
    number: int = 0
    least_ns: int = 0
    """The shortest silence before the request of a case, in ns."""
    required: str = ""
    """The silence that is required before the request, as text: `28bits`, `100 ms`."""


@dataclass(slots=True)
class _Line:
    transactions: int = 0
    in_blocks: int = 0
    """How many transactions are glued (no silence between frames) or split (a silence inside
    one)."""
    of_unit: Counter[int] = field(default_factory=Counter)
    """How many transactions each unit has."""
    silences: dict[tuple[Verdict, int], _Cases] = field(default_factory=dict)
    """The transactions with a wrong silence, by the kind of silence and the unit; at most 256
    units."""
    pace: dict[tuple[str, int], _Cases] = field(default_factory=dict)
    """The requests that came too soon, by code (RTU-301, RTU-302) and unit; at most 256 units."""
    stray: WireEvent | None = None
    """The unreadable bytes after the last frame. They are a finding if another frame follows."""
    end_ns: int | None = None
    """When the last frame ended, in ns."""
    broadcast: NamedTransaction | None = None
    """The last transaction, if it was a broadcast; otherwise None."""


class LineRules:
    """Checks records of serial lines. Findings with counts come at the end of the capture."""

    def __init__(self) -> None:
        self._lines: LruDict[str, _Line] = LruDict(_Line)
        self.remarks: list[str] = []
        """Sentences about wrong silences that are too few for a finding; complete after `close`."""

    def transaction(
        self, transaction: NamedTransaction, profile: Profile | None, format_: SerialFormat | None
    ) -> Iterator[Finding]:
        """Check the next transaction, and give the findings that are certain now.

        Without `format_`, the times of the line's bytes are unknown, so the master's pace is not
        checked.
        """
        line = self._lines[transaction.link]
        line.transactions += 1
        line.of_unit[transaction.unit] += 1
        is_ambiguous = Verdict.AMBIGUOUS in transaction.verdicts
        if line.stray is not None:
            yield event_finding("RTU-202", line.stray)
            line.stray = None
        self._note_silences(line, transaction)
        broadcast = line.broadcast
        if broadcast is not None and not is_ambiguous and _responds_to(broadcast, transaction):
            yield transaction_finding(
                "MB-301",
                transaction,
                f"unit {transaction.unit} answers the broadcast {request_text(broadcast)}",
            )
        elif format_ is not None and transaction.request_raw is not None:
            self._note_pace(line, transaction, profile, format_)
        is_broadcast = transaction.outcome is Outcome.BROADCAST
        if is_broadcast and not is_ambiguous and _only_reads(transaction.function):
            yield transaction_finding(
                "MB-302", transaction, f"{request_text(transaction)} to all units"
            )
        line.end_ns = transaction.response_ns or transaction.request_ns
        line.broadcast = transaction if is_broadcast else None

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Check the next event of a line, and give the findings that are certain now."""
        line = self._lines[event.link]
        match event.kind:
            case EventKind.BAD_CHECK:
                yield event_finding("RTU-201", event, f"{event.message}: {_bytes(event.raw)}")
            case EventKind.LINE_ERROR:
                yield event_finding("RTU-203", event)
            case EventKind.SKIPPED if line.transactions:
                if line.stray is not None:
                    yield event_finding("RTU-202", line.stray)
                line.stray = event

    def is_response_to_broadcast(self, transaction: NamedTransaction) -> bool:
        """True if the next transaction, not yet checked, is the response to a broadcast."""
        if not transaction.transport.is_serial or transaction.link not in self._lines:
            return False
        broadcast = self._lines[transaction.link].broadcast
        return broadcast is not None and _responds_to(broadcast, transaction)

    def close(self) -> Iterator[Finding]:
        """Give the findings with counts, at the end of the capture."""
        for link, line in self._lines.items():
            share = line.in_blocks / max(line.transactions, 1)
            if share >= ADAPTER_SHARE and line.transactions >= MIN_TRANSACTIONS:
                first = next(
                    one.first for (sign, _), one in line.silences.items() if sign in _BLOCK_SIGNS
                )
                yield transaction_finding(
                    "RTU-104",
                    first,
                    f"in {line.in_blocks} of {line.transactions} transactions frames are glued or "
                    "torn; of silences nothing can be said",
                )
                continue
            yield from self._silences(link, line)
            for (code, _), cases in line.pace.items():
                yield _summary(code, cases, _pace_text(code, cases))

    def _silences(self, link: str, line: _Line) -> Iterator[Finding]:
        few: Counter[str] = Counter()
        for (sign, unit), cases in line.silences.items():
            code, text = _SILENCES[sign]
            total = line.of_unit[unit]
            if cases.number >= MIN_SILENCES and cases.number >= MIN_SILENCES_SHARE * total:
                yield _summary(code, cases, f"{text} in {cases.number} of {total} transactions")
            else:
                few[text] += cases.number
        self.remarks += [
            f"{link}: {text} in {number} of {line.transactions} transactions; "
            "so few are probably late reads, and no fault of the line"
            for text, number in few.items()
        ]

    def _note_silences(self, line: _Line, transaction: NamedTransaction) -> None:
        if not transaction.verdicts:
            return
        for sign in _SILENCES:
            if sign in transaction.verdicts:
                key = (sign, transaction.unit)
                line.silences.setdefault(key, _Cases(transaction)).number += 1
        line.in_blocks += not _BLOCK_SIGNS.isdisjoint(transaction.verdicts)

    def _note_pace(
        self,
        line: _Line,
        transaction: NamedTransaction,
        profile: Profile | None,
        format_: SerialFormat,
    ) -> None:
        end_ns, request_ns = line.end_ns, transaction.request_ns
        if end_ns is None or request_ns is None or transaction.request_raw is None:
            return
        silence_ns = request_ns - len(transaction.request_raw) * format_.character_ns - end_ns
        if silence_ns < 0 and request_ns < end_ns:  # The clock was set back.
            return
        silence_ns = max(silence_ns, 0)
        if line.broadcast is not None and silence_ns < TURNAROUND_NS:
            _add_pace(line, "RTU-302", transaction, silence_ns, "100 ms")
        required = profile.timing.request_interval if profile is not None else None
        if required is not None:
            required_ns = Silence.parse(required).ns(format_.baud, format_.character_bits)
            # A time stamp is only exact to the duration of one character.
            if silence_ns < required_ns - format_.character_ns:
                _add_pace(line, "RTU-301", transaction, silence_ns, required)


def _add_pace(
    line: _Line, code: str, transaction: NamedTransaction, silence_ns: int, required: str
) -> None:
    key = (code, transaction.unit)
    cases = line.pace.setdefault(key, _Cases(transaction, 0, silence_ns, required))
    cases.number += 1
    cases.least_ns = min(cases.least_ns, silence_ns)


def _pace_text(code: str, cases: _Cases) -> str:
    before = "a broadcast" if code == "RTU-302" else "the frame before"
    return (
        f"{counted(cases.number, 'request')} sooner than {cases.required} "
        f"after {before}; the soonest after {milliseconds(cases.least_ns)}"
    )


def _summary(code: str, cases: _Cases, text: str) -> Finding:
    one = transaction_finding(code, cases.first, text)
    unit = None if code == "RTU-302" else one.unit
    return replace(one, unit=unit, function=None, reference=None, count=cases.number)


def _responds_to(broadcast: NamedTransaction, transaction: NamedTransaction) -> bool:
    """True if `transaction` is the response to `broadcast`, the frame right before it.

    A response to a write of one value equals its request. So it may be decoded as a request without
    a response.
    """
    if broadcast.request_ns is None or transaction.function != broadcast.function:
        return False
    if transaction.start_ns - broadcast.request_ns > RESPONSE_TO_BROADCAST_NS:
        return False
    if transaction.outcome is Outcome.UNSOLICITED:
        return True
    return (
        transaction.outcome is Outcome.NO_ANSWER
        and transaction.function in WRITE_ONE
        and transaction.start_ns - broadcast.request_ns < TURNAROUND_NS
        and _request(transaction) == _request(broadcast)
    )


def _request(transaction: NamedTransaction) -> bytes | None:
    return whole_pdu(transaction.transport, transaction.request_raw)


def _only_reads(function: int) -> bool:
    known = FUNCTIONS.get(function)
    return known is not None and not known.writes and function != _DIAGNOSTICS


def _bytes(raw: bytes) -> str:
    return raw[:16].hex(" ") + (" ..." if len(raw) > 16 else "")

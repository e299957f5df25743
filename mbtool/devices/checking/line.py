"""The rules for serial lines: silences, damaged bytes, requests that come too soon, broadcasts."""

# MB-301, MB-302    a slave responds to a broadcast; the master tries to read with a broadcast
# RTU-101..104      wrong silences; silences.py finds them
# RTU-202, RTU-203  unreadable bytes, damaged characters
# RTU-301, RTU-302  a request comes too soon after another frame or a broadcast; not checked if
#                   RTU-104 says that the times are useless
#
# A capture may begin and end inside a frame, so unreadable bytes before the first frame of a line
# and after the last one are no finding.
#
# Memory: some numbers for each line and each of its units (LruDict in sliding_window.py).

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, SerialFormat, Silence, WireEvent
from mbtool.core.moments import counted, milliseconds
from mbtool.devices.checking.finding import Finding, event_finding, transaction_finding
from mbtool.devices.checking.silences import LineSilences, silence_before
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import DIAGNOSTICS, FUNCTIONS, WRITE_ONE
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.devices.model import Profile

TURNAROUND_NS = 100_000_000
"""The shortest silence, in ns, that must follow a broadcast. The standard gives 100 to 200 ms as
the usual turnaround delay."""
RESPONSE_TO_BROADCAST_NS = 1_000_000_000
"""A response of the same function at most so many ns after a broadcast counts as a response to
it."""


@dataclass(slots=True)
class _Cases:
    """A summary of the requests to one unit that come too soon after another frame and so break one
    rule, RTU-301 or RTU-302.
    """

    first: NamedTransaction
    number: int = 0
    least_ns: int = 0
    """The shortest silence before one of these requests, in ns."""
    required: str = ""
    """The silence that is required before a request, as text: `28bits`, `100 ms`."""


@dataclass(slots=True)
class _Line:
    silences: LineSilences = field(default_factory=LineSilences)
    pace: dict[tuple[str, int], _Cases] = field(default_factory=dict)
    """The requests that came too soon after the frame before. The key is the code of the rule
    (RTU-301 or RTU-302) and the unit."""
    stray: WireEvent | None = None
    """The unreadable bytes after the last frame; None if there are none. They are the finding
    RTU-202 if another frame follows."""
    format: SerialFormat | None = None
    """The settings of the line; None if the times of its bytes are unknown."""
    end_ns: int | None = None
    """The time at which the last frame ended, in ns; None before the first frame."""
    broadcast: NamedTransaction | None = None
    """The last transaction, if it was a broadcast; otherwise None."""


class LineRules:
    """Checks transactions and events of serial lines.

    Findings that have a number of cases come at the end of the capture.
    """

    def __init__(self, has_exact_times: Callable[[str], bool] = lambda _: False) -> None:
        """Take a function that returns True for the name of a serial link if the time of every byte
        is exact, as from a logic analyser.
        """
        self._has_exact_times = has_exact_times
        self._lines: LruDict[str, _Line] = LruDict(_Line)
        self.remarks: list[str] = []
        """Sentences for the user about wrong silences that are too few for a finding; complete
        after `close`."""

    def transaction(
        self, transaction: NamedTransaction, profile: Profile | None, format_: SerialFormat | None
    ) -> Iterator[Finding]:
        """Check the next transaction of a line. Yields each finding as soon as it is certain.

        `profile` is the slave's; None if it has none. `format_` has the settings of the line; if it
        is None, the times of the line's bytes are unknown, and no request is found to come too
        soon.
        """
        line = self._lines[transaction.link]
        line.silences.note(transaction, format_, line.end_ns)
        line.format = format_ or line.format
        is_ambiguous = Verdict.AMBIGUOUS in transaction.verdicts
        if line.stray is not None:
            yield event_finding("RTU-202", line.stray)
            line.stray = None
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
        """Check the next event of a line. Yields each finding as soon as it is certain."""
        line = self._lines[event.link]
        match event.kind:
            case EventKind.LINE_ERROR:
                yield event_finding("RTU-203", event)
            case EventKind.SKIPPED if line.silences.transactions:
                if line.stray is not None:
                    yield event_finding("RTU-202", line.stray)
                line.stray = event

    def is_response_to_broadcast(self, transaction: NamedTransaction) -> bool:
        """True if a transaction is the response to the broadcast right before it.

        Call it before the transaction is checked.
        """
        if not transaction.transport.is_serial or transaction.link not in self._lines:
            return False
        broadcast = self._lines[transaction.link].broadcast
        return broadcast is not None and _responds_to(broadcast, transaction)

    def close(self) -> Iterator[Finding]:
        """Give the findings about wrong silences and about requests that come too soon.

        Each finding has a number of cases. Call this method at the end of the capture.
        """
        for link, line in self._lines.items():
            silences = line.silences
            if line.format is not None and self._has_exact_times(link):
                yield from silences.exact_findings(line.format)
            elif silences.are_in_blocks and silences.master_splits_requests:
                yield silences.torn_finding()
            elif silences.are_in_blocks:
                yield silences.block_finding()
                continue
            else:
                yield from silences.findings(self.remarks, line.format)
            for (code, _), cases in line.pace.items():
                yield _summary(code, cases, _pace_text(code, cases))

    def _note_pace(
        self,
        line: _Line,
        transaction: NamedTransaction,
        profile: Profile | None,
        format_: SerialFormat,
    ) -> None:
        silence_ns = silence_before(transaction, format_, line.end_ns)
        if silence_ns is None:
            return
        if line.broadcast is not None and silence_ns < TURNAROUND_NS:
            _add_pace(line, "RTU-302", transaction, silence_ns, "100 ms")
        required = profile.timing.request_interval if profile is not None else None
        if required is not None:
            required_ns = Silence.parse(required).ns(format_.baud, format_.character_bits)
            # Where the bytes have no times of their own, the time of a frame is exact to about one
            # character.
            is_exact = self._has_exact_times(transaction.link)
            if silence_ns < required_ns - (0 if is_exact else format_.character_ns):
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

    The response to a write of one value equals its request. So the decoder may have taken the
    response for a request that got no response.
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
    return known is not None and not known.writes and function != DIAGNOSTICS

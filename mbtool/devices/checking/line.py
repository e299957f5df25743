"""The rules for serial lines: silences, damaged bytes, requests that come too soon, broadcasts."""

# MB-301, MB-302    a slave responds to a broadcast; the master tries to read with a broadcast
# RTU-101..104      wrong silences; LineSilences finds them
# RTU-202, RTU-203  unreadable bytes, damaged characters
# RTU-301, RTU-302  a request comes too soon after another frame or a broadcast; not checked if
#                   RTU-104 says that the times are useless
#
# A capture may begin and end inside a frame, so unreadable bytes before the first frame of a line
# and after the last one are no finding.
#
# Memory: some numbers for each line and each of its units (LruDict in sliding_window.py).

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, SerialFormat, Silence, WireEvent
from mbtool.core.moments import counted, milliseconds
from mbtool.devices.checking.finding import Finding, event_finding, transaction_finding
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import DIAGNOSTICS, FUNCTIONS, WRITE_ONE
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.devices.model import Profile


# The rules about silences inside and between the frames of a line: RTU-101 to RTU-104.
#
# How certain a silence is depends on the source of the times.
#
# Times from an adapter, a driver or packets: a serial adapter may collect bytes and deliver them in
# blocks. Then many transactions of a line seem to have no silence between frames, or silences
# inside them, and the times say nothing about the line. RTU-104 reports this once, in place of
# RTU-101..103. A line needs at least MIN_TRANSACTIONS transactions for RTU-104. A busy computer
# sometimes reads late, which looks the same: on healthy lines, up to 16 % of the transactions had a
# wrong silence (measured). A fault of the line affects many transactions of one unit. So
# RTU-101..103 are only reported for a unit if at least MIN_SILENCES of its transactions, and at
# least the share MIN_SILENCES_SHARE of them, have a wrong silence. Otherwise a remark says how many
# there are.
#
# An adapter tears requests and responses alike. So if at least TORN_SHARE of the requests are torn,
# no frames are glued, and at most WHOLE_SHARE of the responses are torn, the master is to blame and
# not the adapter: that is RTU-102 and not RTU-104.
#
# Exact times of every byte, as from a logic analyser: each wrong silence was really on the line, so
# a single one is reported, and there is no RTU-104. RTU-103 says who sent too soon: the slave its
# response, or the master its request.
#
# Memory: for each line, some numbers for each of at most 256 units.

MIN_TRANSACTIONS = 8
ADAPTER_SHARE = 0.25
"""If at least this share of a line's transactions, 0 to 1, has no silence between frames or a
silence inside a frame, an adapter that delivers bytes in blocks is taken to be the reason."""
MIN_SILENCES = 3
MIN_SILENCES_SHARE = 0.2
"""A finding needs a wrong silence in at least this share of a unit's transactions, 0 to 1. On
healthy lines, a busy computer that read late caused a share of up to 0.16 (measured)."""

TORN_SHARE, WHOLE_SHARE = 0.8, 0.05
"""Requests are torn by their master if at least TORN_SHARE of them are, and at most WHOLE_SHARE of
the responses."""

_SILENCES = {
    Verdict.T1_5_BROKEN: ("RTU-101", "a silence longer than t1.5 inside a frame"),
    Verdict.SPLIT: ("RTU-102", "a silence of t3.5 or longer inside a frame"),
    Verdict.GLUED: ("RTU-103", "less than t3.5 of silence between frames"),
}
_BLOCK_SIGNS = frozenset((Verdict.SPLIT, Verdict.GLUED))
_T3_5_CHARACTERS = 3.5


@dataclass(slots=True)
class _Silences:
    """A summary of all transactions of one unit that have one kind of wrong silence.

    The kinds are the rules RTU-101 to RTU-103.
    """

    first: NamedTransaction
    number: int = 0
    least_ns: int | None = None
    """The shortest of the wrong silences, in ns; None if the length of none is known."""

    def add(self, silence_ns: int | None = None) -> None:
        self.number += 1
        if silence_ns is not None:
            known = silence_ns if self.least_ns is None else self.least_ns
            self.least_ns = min(silence_ns, known)


@dataclass(slots=True)
class LineSilences:
    """Counts the wrong silences of one serial line."""

    transactions: int = 0
    in_blocks: int = 0
    """Number of transactions that are glued (no silence between frames) or split (a silence inside
    a frame), as if an adapter delivered bytes in blocks."""
    answered: int = 0
    """Number of transactions with a request and a response."""
    only_request_split: int = 0
    """Number of transactions with a silence inside the request, and none inside the response."""
    of_unit: Counter[int] = field(default_factory=Counter)
    """Number of transactions of each unit."""
    wrong: dict[tuple[Verdict, int], _Silences] = field(default_factory=dict)
    """The transactions with a wrong silence. The key is the verdict that names the kind of silence,
    and the unit."""
    too_soon: dict[tuple[bool, int], _Silences] = field(default_factory=dict)
    """The transactions whose request or response comes too soon after the frame before it. The key
    is a flag (True if it is the request) and the unit."""

    def note(
        self, transaction: NamedTransaction, format_: SerialFormat | None, end_ns: int | None
    ) -> None:
        """Count the wrong silences of the line's next transaction.

        `format_` has the settings of the line; None if the times of its bytes are unknown. `end_ns`
        is the time (ns) at which the frame before the transaction ended; None if there is none.
        """
        self.transactions += 1
        self.of_unit[transaction.unit] += 1
        self.answered += None not in (transaction.request_raw, transaction.response_raw)
        self.only_request_split += Verdict.ONLY_REQUEST_SPLIT in transaction.verdicts
        if not transaction.verdicts:
            return
        for sign in _SILENCES:
            if sign in transaction.verdicts:
                key = (sign, transaction.unit)
                self.wrong.setdefault(key, _Silences(transaction)).add()
        self.in_blocks += not _BLOCK_SIGNS.isdisjoint(transaction.verdicts)
        if format_ is not None and Verdict.GLUED in transaction.verdicts:
            self._note_too_soon(transaction, format_, end_ns)

    def _note_too_soon(
        self, transaction: NamedTransaction, format_: SerialFormat, end_ns: int | None
    ) -> None:
        latency_ns = transaction.latency_ns
        if latency_ns is not None and latency_ns < format_.t3_5_ns:
            self._add_too_soon(transaction, latency_ns, is_request=False)
        before_ns = silence_before(transaction, format_, end_ns)
        # The verdict GLUED may also mean that only the next request follows too soon. So compute
        # the silence before this request from the length of its frame.
        if before_ns is not None and before_ns < 2 * format_.t3_5_ns:
            is_next = latency_ns is None or latency_ns >= format_.t3_5_ns
            if is_next or before_ns < format_.t3_5_ns:
                self._add_too_soon(transaction, before_ns, is_request=True)

    def _add_too_soon(
        self, transaction: NamedTransaction, silence_ns: int, *, is_request: bool
    ) -> None:
        key = (is_request, transaction.unit)
        self.too_soon.setdefault(key, _Silences(transaction)).add(silence_ns)

    @property
    def are_in_blocks(self) -> bool:
        """True if an adapter probably delivers bytes in blocks, so that the silences in the capture
        say nothing about the line.

        That is assumed if the share of transactions without silence between their frames, or with a
        silence inside a frame, is at least ADAPTER_SHARE.
        """
        share = self.in_blocks / max(self.transactions, 1)
        return share >= ADAPTER_SHARE and self.transactions >= MIN_TRANSACTIONS

    @property
    def master_splits_requests(self) -> bool:
        """True if the master tears its requests, while responses are whole and frames apart."""
        is_glued = any(sign is Verdict.GLUED for sign, _ in self.wrong)
        split = sum(one.number for (sign, _), one in self.wrong.items() if sign is Verdict.SPLIT)
        others = split - self.only_request_split
        is_mostly = self.only_request_split >= TORN_SHARE * self.answered
        return is_mostly and not is_glued and others <= WHOLE_SHARE * self.answered

    def torn_finding(self) -> Finding:
        """Make the finding RTU-102 about a master that tears its requests. Call it only if
        `master_splits_requests` and `are_in_blocks`.
        """
        first = next(one for (sign, _), one in self.wrong.items() if sign is Verdict.SPLIT)
        cases = _Silences(first.first, self.only_request_split)
        text = f"in {self.only_request_split} of {self.answered} requests, and in no more than "
        text += f"{WHOLE_SHARE:.0%} of the responses: the master tears them"
        return _silence_finding("RTU-102", cases, f"a silence of t3.5 or longer {text}")

    def block_finding(self) -> Finding:
        """Make the finding RTU-104: the silences say nothing, because bytes come in blocks.

        Call it only if `are_in_blocks`.
        """
        first = next(one.first for (sign, _), one in self.wrong.items() if sign in _BLOCK_SIGNS)
        return transaction_finding(
            "RTU-104",
            first,
            f"in {self.in_blocks} of {self.transactions} transactions frames are glued or torn; "
            "of silences nothing can be said",
        )

    def findings(self, remarks: list[str], format_: SerialFormat | None) -> Iterator[Finding]:
        """Give findings about wrong silences, for times from an adapter, a driver or packets.

        Adds a sentence to `remarks` about wrong silences that are too few for a finding. `format_`
        has the settings of the line; None if they are unknown.
        """
        few: Counter[str] = Counter()
        for (sign, unit), cases in self.wrong.items():
            code, text = _SILENCES[sign]
            total = self.of_unit[unit]
            if cases.number >= MIN_SILENCES and cases.number >= MIN_SILENCES_SHARE * total:
                text += f" in {cases.number} of the unit's {total} transactions"
                which = _which_t3_5(format_) if sign is Verdict.GLUED else ""
                yield _silence_finding(code, cases, text + which)
            else:
                few[text] += cases.number
        remarks += [
            f"{first.link}: {text} in {number} of {self.transactions} transactions; "
            "so few are probably late reads, and no fault of the line"
            for first in [one.first for one in self.wrong.values()][:1]
            for text, number in few.items()
        ]

    def exact_findings(self, format_: SerialFormat) -> Iterator[Finding]:
        """Give findings about wrong silences, for a line whose bytes all have exact times.

        `format_` has the settings of the line.
        """
        for (sign, unit), cases in self.wrong.items():
            code, text = _SILENCES[sign]
            if sign is not Verdict.GLUED:
                total = self.of_unit[unit]
                text += f" in {cases.number} of the unit's {total} transactions"
                yield _silence_finding(code, cases, text)
        for (is_request, unit), cases in self.too_soon.items():
            total = self.of_unit[unit]
            yield _silence_finding(
                "RTU-103", cases, _too_soon_text(is_request, cases, total, format_)
            )


def silence_before(
    transaction: NamedTransaction, format_: SerialFormat, end_ns: int | None
) -> int | None:
    """Return the silence, in ns, between `end_ns`, the end of the frame before, and the request's
    first byte; None if it is unknown.

    The time of the first byte is computed from the end and the length of the request, so it is
    exact to about the duration of one character.
    """
    request_ns, raw = transaction.request_ns, transaction.request_raw
    if end_ns is None or request_ns is None or raw is None or request_ns < end_ns:
        return None  # request_ns < end_ns: the clock was set back.
    return max(request_ns - len(raw) * format_.character_ns - end_ns, 0)


def _too_soon_text(is_request: bool, cases: _Silences, total: int, format_: SerialFormat) -> str:
    unit = cases.first.unit
    who = f"the master asks unit {unit}" if is_request else f"unit {unit} answers"
    least_ns = cases.least_ns or 0
    characters = least_ns / format_.character_ns
    soonest = f"{characters:.1f} characters, {least_ns / 1e6:.2f} ms"
    text = f"{who} too soon in {cases.number} of the unit's {total} transactions, "
    text += f"the soonest after {soonest}"
    return text + _which_t3_5(format_, keeps_characters=characters >= _T3_5_CHARACTERS)


def _which_t3_5(format_: SerialFormat | None, *, keeps_characters: bool = False) -> str:
    """Return a text for a message that says how long t3.5 is, if the standard fixes its length
    (above 19200 baud); else an empty text.

    `format_` has the settings of the line; None if they are unknown. `keeps_characters` is True if
    a silence is shorter than the fixed t3.5, but not shorter than 3.5 characters.
    """
    if format_ is None or not format_.has_fixed_silences:
        return ""
    fixed = f"above 19200 baud the standard fixes t3.5 at {format_.t3_5_ns / 1e6:.2f} ms"
    kept = "; 3.5 characters, the rule of some manuals, are kept" if keeps_characters else ""
    return f"; {fixed}{kept}"


def _silence_finding(code: str, cases: _Silences, text: str) -> Finding:
    one = transaction_finding(code, cases.first, text)
    return replace(one, function=None, reference=None, count=cases.number)


TURNAROUND_NS = 100_000_000
"""The shortest silence, in ns, that must follow a broadcast. The standard gives 100 to 200 ms as
the usual turnaround delay."""
RESPONSE_TO_BROADCAST_NS = 1_000_000_000
"""A response with the function of a broadcast counts as a response to it if it comes at most this
long (ns) after it."""


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
                yield _pace_finding(code, cases, _pace_text(code, cases))

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


def _pace_finding(code: str, cases: _Cases, text: str) -> Finding:
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

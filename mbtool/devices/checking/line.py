"""A serial line: its silences, damage on it, its pace, and broadcasts."""

# MB-301, MB-302    broadcasts: no slave answers, and none can read by one
# RTU-101..103      silences, one finding of each kind for a unit, with how many there are
# RTU-104           one finding for a line, in place of those
# RTU-201..203      damage, one finding each
# RTU-301, RTU-302  the master's pace, one finding for a unit or a line, with figures
#
# The times of a capture can be those of an adapter, which collects bytes and delivers them in
# blocks: frames without a silence between them, or silences inside them, in many transactions of
# a line. What seems to be the line is then its adapter, so RTU-104 says so once, in place of all
# that goes by silences. Below ENOUGH transactions it cannot be told.
#
# A computer that is busy reads late now and then, which looks the same: on healthy lines up to 16 %
# of the transactions were measured to have such a silence. What is the line's is in many of one
# unit's, so it takes SEVERAL, and SHARE of that unit's transactions; fewer are a remark.
#
# A capture may begin and end inside a frame: bytes before the first frame of a line, and after its
# last one, are no finding.
#
# Holds some numbers for each line and each of its units (kept.py).

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import EventKind, Silence, WireEvent
from mbtool.devices.checking.finding import Finding, found, found_in
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import asked_for
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.adu import Verdict
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.pdu import whole_pdu
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import SerialFormat
    from mbtool.devices.model import Profile

TURNAROUND_NS = 100_000_000
"""The least of what the standard calls usual, 100 to 200 ms."""
ANSWERS_WITHIN_NS = 1_000_000_000
"""How soon after a broadcast an answer is one to it."""
ENOUGH = 8
BLOCKS = 0.25
"""From this share of transactions on, silences are the adapter's."""
SEVERAL = 3
SHARE = 0.2
"""From this share of a unit's transactions on, silences are the line's, and no late reads."""

_SILENCES = {
    Verdict.T1_5_BROKEN: ("RTU-101", "a silence longer than t1.5 inside a frame"),
    Verdict.SPLIT: ("RTU-102", "a silence of t3.5 or longer inside a frame"),
    Verdict.GLUED: ("RTU-103", "less than t3.5 of silence between frames"),
}
_BLOCK_SIGNS = frozenset((Verdict.SPLIT, Verdict.GLUED))
_DIAGNOSTICS = 0x08
_ECHOED_WHOLE = frozenset((0x05, 0x06, 0x16))


@dataclass(slots=True)
class _Occurrences:
    """How often something happened, and the first time."""

    first: NamedTransaction
    number: int = 0
    least_ns: int = 0
    wanted: str = ""
    """How long a silence there should be."""


@dataclass(slots=True)
class _Line:
    """What is known of a line."""

    transactions: int = 0
    in_blocks: int = 0
    of_unit: Counter[int] = field(default_factory=Counter)
    """Transactions, by unit."""
    silences: dict[tuple[Verdict, int], _Occurrences] = field(default_factory=dict)
    """By kind and unit: at most 256 units."""
    pace: dict[tuple[str, int], _Occurrences] = field(default_factory=dict)
    """By code and unit: at most 256 units."""
    stray: WireEvent | None = None
    """Bytes that are a finding if a frame follows."""
    end_ns: int | None = None
    """When the last frame ended."""
    broadcast: NamedTransaction | None = None
    """The last frame, if it was one."""


class LineRules:
    """Records of serial lines in; findings out, those with figures at the end."""

    def __init__(self) -> None:
        self._lines: LruDict[str, _Line] = LruDict(_Line)
        self.remarks: list[str] = []
        """Silences that are too few for a finding, once the capture has ended."""

    def transaction(
        self, transaction: NamedTransaction, profile: Profile | None, format_: SerialFormat | None
    ) -> Iterator[Finding]:
        """Take the next transaction. Without a format the times of the line are not known."""
        line = self._lines[transaction.link]
        line.transactions += 1
        line.of_unit[transaction.unit] += 1
        is_doubtful = Verdict.AMBIGUOUS in transaction.verdicts
        if line.stray is not None:
            yield found_in("RTU-202", line.stray)
            line.stray = None
        self._note_silences(line, transaction)
        answered = line.broadcast is not None and _answers(line.broadcast, transaction)
        if answered and line.broadcast is not None and not is_doubtful:
            yield found(
                "MB-301",
                transaction,
                f"unit {transaction.unit} answers the broadcast {asked_for(line.broadcast)}",
            )
        elif format_ is not None and transaction.request_raw is not None:
            self._note_pace(line, transaction, profile, format_)
        is_broadcast = transaction.outcome is Outcome.BROADCAST
        if is_broadcast and not is_doubtful and _only_reads(transaction.function):
            yield found("MB-302", transaction, f"{asked_for(transaction)} to all units")
        line.end_ns = transaction.response_ns or transaction.request_ns
        line.broadcast = transaction if is_broadcast else None

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Take the next event of a line."""
        line = self._lines[event.link]
        match event.kind:
            case EventKind.BAD_CHECK:
                yield found_in("RTU-201", event, f"{event.message}: {_bytes(event.raw)}")
            case EventKind.LINE_ERROR:
                yield found_in("RTU-203", event)
            case EventKind.SKIPPED if line.transactions:
                if line.stray is not None:
                    yield found_in("RTU-202", line.stray)
                line.stray = event

    def is_answer_to_broadcast(self, transaction: NamedTransaction) -> bool:
        """Whether a record that has not been taken yet answers a broadcast."""
        if not transaction.transport.is_serial or transaction.link not in self._lines:
            return False
        broadcast = self._lines[transaction.link].broadcast
        return broadcast is not None and _answers(broadcast, transaction)

    def close(self) -> Iterator[Finding]:
        """The capture ends."""
        for link, line in self._lines.items():
            share = line.in_blocks / max(line.transactions, 1)
            if share >= BLOCKS and line.transactions >= ENOUGH:
                first = next(
                    one.first for (sign, _), one in line.silences.items() if sign in _BLOCK_SIGNS
                )
                yield found(
                    "RTU-104",
                    first,
                    f"in {line.in_blocks} of {line.transactions} transactions frames are glued or "
                    "torn; of silences nothing can be said",
                )
                continue
            yield from self._silences(link, line)
            for (code, _), count in line.pace.items():
                yield _of_many(code, count, _pace_text(code, count))

    def _silences(self, link: str, line: _Line) -> Iterator[Finding]:
        few: Counter[str] = Counter()
        for (sign, unit), count in line.silences.items():
            code, text = _SILENCES[sign]
            asked = line.of_unit[unit]
            if count.number >= SEVERAL and count.number >= SHARE * asked:
                yield _of_many(code, count, f"{text} in {count.number} of {asked} transactions")
            else:
                few[text] += count.number
        self.remarks += [
            f"{link}: {text} in {number} of {line.transactions} transactions; "
            "so few are late reads more likely than the line's"
            for text, number in few.items()
        ]

    def _note_silences(self, line: _Line, transaction: NamedTransaction) -> None:
        if not transaction.verdicts:
            return
        for sign in _SILENCES:
            if sign in transaction.verdicts:
                key = (sign, transaction.unit)
                line.silences.setdefault(key, _Occurrences(transaction)).number += 1
        line.in_blocks += not _BLOCK_SIGNS.isdisjoint(transaction.verdicts)

    def _note_pace(
        self,
        line: _Line,
        transaction: NamedTransaction,
        profile: Profile | None,
        format_: SerialFormat,
    ) -> None:
        end_ns, asked_ns = line.end_ns, transaction.request_ns
        if end_ns is None or asked_ns is None or transaction.request_raw is None:
            return
        silence_ns = asked_ns - len(transaction.request_raw) * format_.character_ns - end_ns
        if silence_ns < 0 and asked_ns < end_ns:  # The clock was set back.
            return
        silence_ns = max(silence_ns, 0)
        if line.broadcast is not None:
            _note_least(line, "RTU-302", transaction, silence_ns, TURNAROUND_NS, "100 ms")
        wanted = profile.timing.request_interval if profile is not None else None
        if wanted is not None:
            wanted_ns = Silence.parse(wanted).ns(format_.baud, format_.character_bits)
            # A time stamp is never better than the character it is taken at.
            least_ns = wanted_ns - format_.character_ns
            _note_least(line, "RTU-301", transaction, silence_ns, least_ns, wanted)


def _note_least(
    line: _Line,
    code: str,
    transaction: NamedTransaction,
    silence_ns: int,
    least_ns: int,
    wanted: str,
) -> None:
    if silence_ns >= least_ns:
        return
    count = line.pace.setdefault(
        (code, transaction.unit), _Occurrences(transaction, 0, silence_ns, wanted)
    )
    count.number += 1
    count.least_ns = min(count.least_ns, silence_ns)


def _pace_text(code: str, count: _Occurrences) -> str:
    requests = "1 request" if count.number == 1 else f"{count.number} requests"
    behind = "a broadcast" if code == "RTU-302" else "the frame before"
    return (
        f"{requests} sooner than {count.wanted} after {behind}; the soonest after "
        f"{count.least_ns / 1e6:.1f} ms"
    )


def _of_many(code: str, count: _Occurrences, text: str) -> Finding:
    one = found(code, count.first, text)
    unit = None if code == "RTU-302" else one.unit
    return replace(one, unit=unit, function=None, reference=None, count=count.number)


def _answers(broadcast: NamedTransaction, transaction: NamedTransaction) -> bool:
    """Whether a frame answers the broadcast right before it.

    The answer to a write of one value repeats it, so it has the form of a request that nobody then
    answers.
    """
    if broadcast.request_ns is None or transaction.function != broadcast.function:
        return False
    if transaction.start_ns - broadcast.request_ns > ANSWERS_WITHIN_NS:
        return False
    if transaction.outcome is Outcome.UNSOLICITED:
        return True
    return (
        transaction.outcome is Outcome.NO_ANSWER
        and transaction.function in _ECHOED_WHOLE
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

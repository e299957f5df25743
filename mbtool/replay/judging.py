"""Compares what a slave answers with what the recorded one answered, by meaning."""

# Each answer is held against the recorded one of the same step:
#
#     outcome   answered or not, ok or which exception, an answer that breaks its form or is to
#               another function, or one with another quantity of values
#     value     each register or bit that was read, one by one
#     data      functions whose form says nothing of registers: the bytes
#
# What differs is put together by request, and by register: how often, and of how many, where that
# is not always; the recorded values, and those that came. So a register that is wrong in a thousand
# polls is one difference. Latencies are kept beside, and count only where the user says by how much
# they may differ.
#
# Registers that may differ: those of `spans`, which the user names, and those that differed in a
# run in which the judge learned; `learned` gives them.
#
# Memory grows with what was asked, not with how often: see traffic.py for its bounds. At most
# MAX_WRONG outcomes of one request are kept, such as the bytes of a counter; what is more is one.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.devices import Difference, Side, Span
from mbtool.devices import DifferenceKind as Kind
from mbtool.modbus import exception_name, parse_pdu, register_access
from mbtool.replay.script import Step
from mbtool.replay.traffic import Held, Sample, ValueKey
from mbtool.replay.wording import DeviceWording, function_text, held_text, latency_side

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mbtool.devices import Profile
    from mbtool.modbus import RegisterAccess

NO_ANSWER = "no answer"
SHOWN_BYTES = 16
MAX_WRONG = 16

_OK = "ok"
_OTHERS = ("others", "others")
_EXCEPTION_BIT = 0x80


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How much later answers may come than the recorded ones."""

    share: float = 0.0
    """Of the recorded median and 95th percentile: 0.5 is half as long again."""
    least_ns: int = 1_000_000
    """So much later is no difference whatever the share."""

    def latest_ns(self, recorded_ns: int) -> float:
        return recorded_ns + max(recorded_ns * self.share, self.least_ns)


@dataclass(slots=True)
class _Judged:
    """One request and its repetitions."""

    step: Step
    count: int = 0
    different: int = 0
    wrong: dict[tuple[str, str], int] = field(default_factory=dict)
    """How often what was recorded, and what came in its place."""
    recorded: Sample = field(default_factory=Sample)
    answered: Sample = field(default_factory=Sample)

    def add_wrong(self, recorded: str, came: str) -> None:
        """Count an answer that is wrong; two equal texts say that its values are."""
        self.different += 1
        if recorded == came:
            return
        pair = recorded, came
        if pair not in self.wrong and len(self.wrong) >= MAX_WRONG:
            pair = _OTHERS
        self.wrong[pair] = self.wrong.get(pair, 0) + 1


@dataclass(slots=True)
class _Pair:
    """A register: what was recorded and what came, where they differed."""

    recorded: Held = field(default_factory=Held)
    came: Held = field(default_factory=Held)
    count: int = 0


class RequestReport(msgspec.Struct, frozen=True, kw_only=True):
    """One request and its repetitions, for reports."""

    unit: int
    function: int
    what: str
    reference: str
    count: int
    different: int
    """How many of its answers were not as recorded."""


class Judge:
    """Takes answers one by one, and says in what they differ."""

    def __init__(
        self,
        *,
        profiles: Mapping[str, Profile] | None = None,
        spans: Sequence[Span] = (),
        learns: bool = False,
        tolerance: Tolerance | None = None,
    ) -> None:
        """`profiles` by name, for the words; without `tolerance` latencies do not count."""
        self._profiles = profiles or {}
        self._spans = list(spans)
        self._learns = learns
        self._tolerance = tolerance
        self._of_devices: dict[str | None, DeviceWording] = {}
        self._asked: dict[tuple[int, bytes], _Judged] = {}
        self._registers: dict[tuple[int, str | None, ValueKey], _Pair] = {}
        self.count = 0
        """How many answers were judged."""
        self.wrong = 0
        """How many of them differed."""

    def judge(self, step: Step, answer: bytes | None, latency_ns: int | None) -> bool:
        """Whether an answer, or None for silence, means what the recorded one means."""
        self.count += 1
        asked = self._asked.setdefault((step.unit, step.pdu), _Judged(step))
        asked.count += 1
        if step.latency_ns is not None and latency_ns is not None:
            asked.recorded.add(step.latency_ns)
            asked.answered.add(latency_ns)
        if step.is_broadcast or answer == step.expected:
            return True
        recorded, came = (_outcome(pdu, step.pdu[0]) for pdu in (step.expected, answer))
        is_right = False
        if step.expected is not None and answer is not None and recorded == came:
            reach = register_access(parse_pdu(step.pdu, Direction.REQUEST))
            if recorded != _OK or reach is None or not reach.reads:
                recorded, came = _apart(step.expected, answer)
            elif len(answer) != len(step.expected):
                recorded, came = _length(step.expected), _length(answer)
            else:
                is_right = self._has_right_values(step, step.expected, reach, answer)
        if not is_right:
            self.wrong += 1
            asked.add_wrong(recorded, came)
        return is_right

    def differences(self) -> list[Difference]:
        """What differed, by unit: outcomes in the order of the requests, then values, latencies."""
        found = [*self._outcomes(), *self._value_differences(), *self._latencies()]
        return sorted(found, key=lambda one: one.unit)

    def requests(self) -> list[RequestReport]:
        """What was asked, in the order in which it was first asked."""
        return [
            RequestReport(
                unit=asked.step.unit,
                function=asked.step.pdu[0],
                what=function_text(asked.step.pdu[0], asked.step.function_name),
                reference=asked.step.reference,
                count=asked.count,
                different=asked.different,
            )
            for asked in self._asked.values()
        ]

    def learned(self) -> list[tuple[int, Span]]:
        """The units and registers that differed, as ranges."""
        spans: list[tuple[int, Span]] = []
        for unit, place in sorted({(unit, place) for unit, _, place in self._registers}):
            one = Span(place.table, place.address, place.address)
            if spans:
                before, span = spans[-1]
                if (before, span.table, span.last + 1) == (unit, one.table, one.first):
                    spans[-1] = unit, Span(one.table, span.first, one.last)
                    continue
            spans.append((unit, one))
        return spans

    def _has_right_values(
        self, step: Step, expected: bytes, reach: RegisterAccess, answer: bytes
    ) -> bool:
        recorded, came = (
            parse_pdu(pdu, Direction.RESPONSE).numbers() or () for pdu in (expected, answer)
        )
        is_right = True
        for address, before, after in zip(reach.reads, recorded, came, strict=False):
            place = ValueKey(reach.table, address, is_written=False)
            if before == after or self._may_differ(place):
                continue
            pair = self._registers.setdefault((step.unit, step.device, place), _Pair())
            pair.recorded.add(before)
            pair.came.add(after)
            pair.count += 1
            is_right = self._learns and is_right
        return is_right

    def _may_differ(self, place: ValueKey) -> bool:
        return any(span.table is place.table and place.address in span for span in self._spans)

    def _outcomes(self) -> Iterable[Difference]:
        for asked in self._asked.values():
            for (recorded, came), count in asked.wrong.items():
                text = _counted(came, count, asked.count)
                yield _about(asked, Kind.OUTCOME, Side(text=recorded), Side(text=text, count=count))

    def _value_differences(self) -> Iterable[Difference]:
        if self._learns:
            return
        reads = self._reads()
        for unit, device, place in sorted(self._registers, key=lambda key: (key[0], key[2])):
            pair = self._registers[unit, device, place]
            words = self._words(device)
            name, named = words.of(place)
            came = held_text(pair.came, named)
            yield Difference(
                kind=Kind.VALUE,
                unit=unit,
                reference=words.reference(place.table, place.address),
                name=name,
                what="read",
                a=Side(text=held_text(pair.recorded, named), values=list(pair.recorded.values)),
                b=Side(
                    text=_counted(came, pair.count, reads[unit, place]),
                    values=list(pair.came.values),
                    count=pair.count,
                ),
            )

    def _reads(self) -> Counter[tuple[int, ValueKey]]:
        """How often each register that differed was asked for."""
        differed = {(unit, place) for unit, _, place in self._registers}
        reads: Counter[tuple[int, ValueKey]] = Counter()
        for asked in self._asked.values():
            step = asked.step
            reach = register_access(parse_pdu(step.pdu, Direction.REQUEST))
            if reach is None:
                continue
            for address in reach.reads:
                key = step.unit, ValueKey(reach.table, address, is_written=False)
                if key in differed:
                    reads[key] += asked.count
        return reads

    def _words(self, device: str | None) -> DeviceWording:
        if device not in self._of_devices:
            profile = self._profiles.get(device) if device is not None else None
            self._of_devices[device] = DeviceWording(profile)
        return self._of_devices[device]

    def _latencies(self) -> Iterable[Difference]:
        if self._tolerance is None:
            return
        for asked in self._asked.values():
            if not asked.recorded.values:
                continue
            recorded, came = latency_side(asked.recorded), latency_side(asked.answered)
            medians = recorded.median_ns or 0, came.median_ns or 0
            tails = recorded.p95_ns or 0, came.p95_ns or 0
            if any(after > self._tolerance.latest_ns(before) for before, after in (medians, tails)):
                yield _about(asked, Kind.LATENCY, recorded, came)


def _about(asked: _Judged, kind: Kind, a: Side, b: Side) -> Difference:
    step = asked.step
    return Difference(
        kind=kind,
        unit=step.unit,
        function=step.pdu[0],
        reference=step.reference or None,
        what=function_text(step.pdu[0], step.function_name),
        a=a,
        b=b,
    )


def _counted(text: str, count: int, total: int) -> str:
    """What came, and how often where it did not come always."""
    return text if count == total else f"{text} ({count:,} of {total:,})"


def _outcome(pdu: bytes | None, function: int) -> str:
    if pdu is None:
        return NO_ANSWER
    if pdu[0] | _EXCEPTION_BIT != function | _EXCEPTION_BIT:
        return f"answer to function {pdu[0] & ~_EXCEPTION_BIT:02X}"
    if pdu[0] & _EXCEPTION_BIT:
        if len(pdu) != 2:
            return f"malformed exception {_shown(pdu)}"
        return f"exception {pdu[1]:02X} {exception_name(pdu[1])}"
    problem = parse_pdu(pdu, Direction.RESPONSE).problem
    return _OK if problem is None else f"malformed: {problem}"


def _length(pdu: bytes) -> str:
    return f"{len(pdu) - 2} bytes of values"


def _apart(pdu: bytes, other: bytes) -> tuple[str, str]:
    """The bytes of both, from the beginning or, where that would hide it, what differs."""
    first = next((at for at, (a, b) in enumerate(zip(pdu, other, strict=False)) if a != b), None)
    if first is None or first < SHOWN_BYTES:
        return _shown(pdu), _shown(other)
    return f"byte {first}: {_shown(pdu[first:])}", f"byte {first}: {_shown(other[first:])}"


def _shown(pdu: bytes) -> str:
    text = pdu[:SHOWN_BYTES].hex(" ")
    return text if len(pdu) <= SHOWN_BYTES else f"{text} ... ({len(pdu)} bytes)"

"""Compares a slave's responses with the recorded ones, by meaning."""

# Each response is compared with the recorded one of the same step:
#
#     outcome   response or none, ok or which exception, a malformed response, another function,
#               another number of values
#     value     each register or bit that was read
#     data      the bytes, for functions whose responses have no registers
#
# Differences are grouped by request and by register. Each shows how often responses differed (and
# of how many, unless all did), the recorded values, and the new values. So a register that is wrong
# in a thousand polls is one difference. Requests with the same unit, function and addresses count
# as repetitions of one request, even if they write other values. Requests that access no registers
# must have the same bytes.
#
# Latencies are always recorded, but compared only if the user gives a tolerance. The tolerance is
# added to each recorded latency. The new latencies differ if they are significantly longer, by the
# test that `diff` uses (comparing.py): a rank test of at least MIN_VALUES latencies, with a
# shift of at least medium size, at the level ALPHA for all requests together. The 2nd percentile
# must be longer, too. The reason: on a busy machine, both programs wait for a processor, which
# lengthens many latencies by several ms, but not all; a slower slave lengthens all. Measured with
# both cores of a machine kept busy (load 12), in 24 samples of 30 responses: the fastest response
# of a sample was at most 1.3 ms late, the fourth fastest up to 7.1 ms, the median 4 to 15 ms.
#
# The user can say by how much values may differ (tolerances.py), and name registers that may differ
# in any way (`spans`). With `learns`, no register counts as a difference; `learned` returns those
# that differed.
#
# Memory grows with the number of different requests, not with their repetitions (limits as in
# traffic.py). For one request, at most MAX_OUTCOMES different outcomes are kept, as responses with
# a counter differ every time; all other outcomes are counted together.

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import Direction
from mbtool.devices import Difference, Profile, Side, Span
from mbtool.devices import DifferenceKind as Kind
from mbtool.modbus import RegisterAccess, exception_name, parse_pdu, register_access
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.replay.comparing import ALPHA, MIN_VALUES, rank_sum
from mbtool.replay.script import Step
from mbtool.replay.traffic import NO_ANSWER, ObservedValues, Sample, ValueKey
from mbtool.replay.wording import DeviceWording, function_text, latency_side, values_text

if TYPE_CHECKING:
    from mbtool.replay.tolerances import Tolerances

SHOWN_BYTES = 16
MAX_OUTCOMES = 16
MAX_CONNECTIONS = 1024
"""The most differences of connections that are kept."""

_OK = "ok"
_OTHER_OUTCOMES = ("others", "others")


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The tolerance by which a new latency may be longer than the recorded one: the greater of a
    share of the latency (`share`) and a time (`least_ns`).
    """

    share: float = 0.0
    """Allowed increase as a share of the recorded latency: 0.5 is 50 %."""
    least_ns: int = 1_000_000
    """An increase in ns that is always allowed, however small the recorded latency is."""

    def latest_ns(self, recorded_ns: int) -> float:
        return recorded_ns + max(recorded_ns * self.share, self.least_ns)


@dataclass(slots=True)
class _RequestResult:
    """The results of one request and its repetitions, as they are collected."""

    step: Step
    count: int = 0
    different: int = 0
    outcomes: dict[tuple[str, str], int] = field(default_factory=dict)
    """The number of responses with another outcome than recorded, by a pair of texts: the recorded
    outcome and the new one."""
    recorded: Sample = field(default_factory=Sample)
    """The recorded latencies (ns) of the responses whose new latencies are in `answered`."""
    answered: Sample = field(default_factory=Sample)
    """The latencies (ns) that were measured when the recording was played."""
    time_ns: int = 0
    """The sum (ns) of all latencies measured for the request when the recording was played."""
    registers: set[tuple[str | None, ValueKey]] = field(default_factory=set)
    """The registers whose values differed from the recorded ones: pairs of the name of the device's
    profile (None without profile) and the register."""

    @property
    def what(self) -> str:
        return function_text(self.step.pdu[0], self.step.function_name)

    @property
    def has_enough_latencies(self) -> bool:
        return len(self.answered.values) >= MIN_VALUES

    def add_latencies(self, recorded_ns: int, answered_ns: int) -> None:
        self.recorded.add(recorded_ns)
        self.answered.add(answered_ns)

    def add_difference(self, recorded: str, outcome: str) -> None:
        """Count a response that differs from the recorded one; both outcomes are texts.

        Equal texts mean that only values of registers differ. Such a response is counted in
        `different`, but not in `outcomes`.
        """
        self.different += 1
        if recorded == outcome:
            return
        pair = recorded, outcome
        if pair not in self.outcomes and len(self.outcomes) >= MAX_OUTCOMES:
            pair = _OTHER_OUTCOMES
        self.outcomes[pair] = self.outcomes.get(pair, 0) + 1


@dataclass(slots=True)
class _RegisterResult:
    """The recorded and new values of a register, from the reads in which the two differed."""

    recorded: ObservedValues = field(default_factory=ObservedValues)
    answered: ObservedValues = field(default_factory=ObservedValues)
    count: int = 0


class RequestReport(msgspec.Struct, frozen=True, kw_only=True):
    """The results of one request and its repetitions, as they appear in a report."""

    unit: int
    function: int
    what: str
    reference: str
    """The addresses in the request, in the notation of the device; its bytes if it has none."""
    count: int
    different: int
    """The number of responses to the request that differed from the recorded ones."""
    time_ns: int
    """The sum of the latencies of all new responses to the request, in ns."""
    problems: list[str]
    """One text for each outcome that differs from the recorded one, and one if the latencies are
    too long, such as "recorded ok, answered exception 02"."""
    registers: list[str]
    """The registers that differed from the recorded responses, in the device's notation."""


class ResponseJudge:
    """Compares a live slave's responses with the recorded ones, and collects the differences."""

    def __init__(
        self,
        *,
        profiles: Mapping[str, Profile] | None = None,
        spans: Sequence[Span] = (),
        learns: bool = False,
        tolerance: Tolerance | None = None,
        values: Tolerances | None = None,
    ) -> None:
        """Prepare to compare.

        `profiles` are the device profiles by name; they give names and units of measure. Registers
        in `spans` may differ from the recording, and those in `values` by the amounts that it says.
        Without `tolerance`, latencies are not compared.
        With `learns`, registers that differ are collected for `learned` and do not count as
        differences.
        """
        self._profiles = profiles or {}
        self._spans = list(spans)
        self._learns = learns
        self._tolerance = tolerance
        self._values = values
        self._wordings: dict[str | None, DeviceWording] = {}
        self._results: dict[tuple[int, int, object], _RequestResult] = {}
        """The results of each request. The key is the unit, the function, and the registers that
        the request accesses; for a request that accesses none, its PDU instead."""
        self._result_of: dict[tuple[int, bytes], _RequestResult] = {}
        """The results in `_results` again, by unit and request PDU, to find them without
        parsing."""
        self._registers: dict[tuple[int, str | None, ValueKey], _RegisterResult] = {}
        """For each register that differed from the recording: its recorded and new values. The key
        is the unit, the name of the device's profile (None without profile) and the register."""
        self.count = 0
        """The number of played requests that were judged, also those without a response."""
        self.wrong_connections = 0
        """The number of connections that were not opened or ended as recorded."""
        self.connections = 0
        """The number of connections that were judged."""
        self._connections: list[Difference] = []
        self.wrong = 0
        """The number of requests whose new response (or silence) differed from the recorded one."""

    def judge(self, step: Step, response: bytes | None, latency_ns: int | None) -> bool:
        """Compare the new response to a step (a recorded request) with the recorded response.

        `response` is the PDU of the new response, None if none came. `latency_ns` is its latency,
        None if unknown. Returns True if both responses mean the same, and for a request whose
        recorded response the capture lost.
        """
        self.count += 1
        result = self._result(step)
        result.count += 1
        result.time_ns += latency_ns or 0
        if step.latency_ns is not None and latency_ns is not None:
            result.add_latencies(step.latency_ns, latency_ns)
        if step.is_broadcast or not step.is_captured:
            return True
        has_counters = self._values is not None and self._values.has_counters
        if response == step.expected and not (has_counters and response is not None):
            return True
        recorded, outcome = (_outcome(pdu, step.pdu[0]) for pdu in (step.expected, response))
        is_right = False
        if step.expected is not None and response is not None and recorded == outcome:
            access = register_access(parse_pdu(step.pdu, Direction.REQUEST))
            if recorded != _OK or access is None or not access.reads:
                recorded, outcome = _differing_bytes(step.expected, response)
            elif len(response) != len(step.expected):
                recorded, outcome = _length(step.expected), _length(response)
            else:
                is_right = self._has_right_values(result, step.expected, access, response)
        if not is_right:
            self.wrong += 1
            result.add_difference(recorded, outcome)
        return is_right

    def differences(self) -> list[Difference]:
        """Return all differences, sorted by unit. For each unit, outcomes come first, then values,
        then latencies.
        """
        alpha = self._alpha()
        results = self._results.values()
        outcomes = (one for result in results for one in _outcomes(result))
        latencies = (one for result in results for one in self._latencies(result, alpha))
        found = [*outcomes, *self._value_differences(), *latencies]
        return [*sorted(found, key=lambda one: one.unit or 0), *self._connections]

    def judge_connection(self, number: int, recorded: str, answered: str) -> None:
        """Compare what became of the connection `number` (from 0) with what is recorded of it, both
        in words. At most MAX_CONNECTIONS differences are kept.
        """
        self.connections += 1
        self.wrong_connections += recorded != answered
        if recorded != answered and len(self._connections) < MAX_CONNECTIONS:
            self._connections.append(
                Difference(
                    kind=Kind.CONNECTION,
                    what=f"connection {number + 1}",
                    a=Side(text=recorded),
                    b=Side(text=answered),
                )
            )

    def requests(self) -> list[RequestReport]:
        """The results of each request, in the order in which the requests were first sent."""
        alpha = self._alpha()
        return [
            RequestReport(
                unit=result.step.unit,
                function=result.step.pdu[0],
                what=result.what,
                reference=result.step.reference or result.step.pdu.hex(" "),
                count=result.count,
                different=result.different,
                time_ns=result.time_ns,
                problems=[
                    f"recorded {one.a.text}, answered {one.b.text}"
                    for one in (*_outcomes(result), *self._latencies(result, alpha))
                ],
                registers=[
                    self._wording(device).reference(key.table, key.address)
                    for device, key in sorted(result.registers, key=lambda one: one[1])
                ],
            )
            for result in self._results.values()
        ]

    def uncompared_latencies(self) -> int:
        """The number of requests with responses, but too few (below MIN_VALUES) to compare
        latencies.

        0 if the user did not ask to compare latencies.
        """
        if self._tolerance is None:
            return 0
        return sum(
            bool(result.answered.values) and not result.has_enough_latencies
            for result in self._results.values()
        )

    def learned(self) -> list[tuple[int, Span]]:
        """The registers that differed from the recording, as pairs of unit and address range."""
        spans: list[tuple[int, Span]] = []
        for unit, key in sorted({(unit, key) for unit, _, key in self._registers}):
            one = Span(key.table, key.address, key.address)
            if spans:
                before, span = spans[-1]
                if (before, span.table, span.last + 1) == (unit, one.table, one.first):
                    spans[-1] = unit, Span(one.table, span.first, one.last)
                    continue
            spans.append((unit, one))
        return spans

    def _result(self, step: Step) -> _RequestResult:
        """Return the object that collects a step's results; steps with equal requests share it."""
        result = self._result_of.get((step.unit, step.pdu))
        if result is None:
            access = register_access(parse_pdu(step.pdu, Direction.REQUEST))
            key = step.unit, step.pdu[0], access or step.pdu
            result = self._results.setdefault(key, _RequestResult(step))
            self._result_of[step.unit, step.pdu] = result
        return result

    def _has_right_values(
        self, request: _RequestResult, expected: bytes, access: RegisterAccess, response: bytes
    ) -> bool:
        recorded, answered = (
            parse_pdu(pdu, Direction.RESPONSE).numbers() or () for pdu in (expected, response)
        )
        step, is_right = request.step, True
        right: set[int] = set()
        wrong: set[int] = set()
        if self._values is not None:
            right, wrong = self._values.judged(
                step.unit, step.device, access.table, access.reads, recorded, answered
            )
        for address, before, after in zip(access.reads, recorded, answered, strict=False):
            key = ValueKey(access.table, address, is_written=False)
            is_same = (before == after and address not in wrong) or address in right
            if is_same or key.is_in(self._spans):
                continue
            result = self._registers.setdefault((step.unit, step.device, key), _RegisterResult())
            result.recorded.add(before)
            result.answered.add(after)
            result.count += 1
            if not self._learns:
                is_right = False
                request.registers.add((step.device, key))
        return is_right

    def _value_differences(self) -> Iterable[Difference]:
        if self._learns:
            return
        reads = self._reads()
        for unit, device, key in sorted(self._registers, key=lambda each: (each[0], each[2])):
            result = self._registers[unit, device, key]
            wording = self._wording(device)
            name, point = wording.of(key)
            answered = values_text(result.answered, point)
            yield Difference(
                kind=Kind.VALUE,
                unit=unit,
                reference=wording.reference(key.table, key.address),
                name=name,
                what="read",
                a=Side(
                    text=values_text(result.recorded, point), values=list(result.recorded.values)
                ),
                b=Side(
                    text=_with_count(answered, result.count, reads[unit, key]),
                    values=list(result.answered.values),
                    count=result.count,
                ),
            )

    def _reads(self) -> Counter[tuple[int, ValueKey]]:
        """The number of reads of each register whose value differed, by unit and register,
        including reads whose value was as recorded.
        """
        differed = {(unit, key) for unit, _, key in self._registers}
        reads: Counter[tuple[int, ValueKey]] = Counter()
        for result in self._results.values():
            step = result.step
            access = register_access(parse_pdu(step.pdu, Direction.REQUEST))
            if access is None:
                continue
            for address in access.reads:
                key = step.unit, ValueKey(access.table, address, is_written=False)
                if key in differed:
                    reads[key] += result.count
        return reads

    def _wording(self, device: str | None) -> DeviceWording:
        if device not in self._wordings:
            self._wordings[device] = DeviceWording.of_device(device, self._profiles)
        return self._wordings[device]

    def _alpha(self) -> float:
        """The significance level of one test: ALPHA divided by the number of requests tested."""
        tests = sum(result.has_enough_latencies for result in self._results.values())
        return ALPHA / max(tests, 1)

    def _latencies(self, result: _RequestResult, alpha: float) -> Iterable[Difference]:
        """Yield one Difference if a request's new latencies are too long at the level `alpha`."""
        if self._tolerance is None:
            return
        allowed = [self._tolerance.latest_ns(each) for each in result.recorded.values]
        shift = rank_sum(allowed, result.answered.values)
        is_longer = shift.p < alpha and shift.is_medium and shift.exceeds > 0.5
        if is_longer and _soonest(result.answered.values) > _soonest(allowed):
            recorded, answered = latency_side(result.recorded), latency_side(result.answered)
            yield _difference(result, Kind.LATENCY, recorded, answered, shift.p)


def _soonest(values: Iterable[float]) -> float:
    """The 2nd percentile of `values`; of fewer than 50 values, the least one."""
    ordered = sorted(values)
    return ordered[len(ordered) // 50]


def _outcomes(result: _RequestResult) -> Iterable[Difference]:
    """Yield a Difference for each outcome of a request that differs from the recorded one."""
    for (recorded, outcome), count in result.outcomes.items():
        text = _with_count(outcome, count, result.count)
        yield _difference(result, Kind.OUTCOME, Side(text=recorded), Side(text=text, count=count))


def _difference(
    result: _RequestResult, kind: Kind, a: Side, b: Side, p: float | None = None
) -> Difference:
    step = result.step
    return Difference(
        kind=kind,
        unit=step.unit,
        function=step.pdu[0],
        reference=step.reference or None,
        what=result.what,
        a=a,
        b=b,
        p=p,
    )


def _with_count(text: str, count: int, total: int) -> str:
    """Return `text`, followed by "(3 of 7)" if `count` is 3 and `total` is 7. If both are equal,
    return only `text`.
    """
    return text if count == total else f"{text} ({count:,} of {total:,})"


def _outcome(pdu: bytes | None, function: int) -> str:
    if pdu is None:
        return NO_ANSWER
    if pdu[0] | EXCEPTION_BIT != function | EXCEPTION_BIT:
        return f"answer to function {pdu[0] & ~EXCEPTION_BIT:02X}"
    if pdu[0] & EXCEPTION_BIT:
        if len(pdu) != 2:
            return f"malformed exception {_hex_text(pdu)}"
        return f"exception {pdu[1]:02X} {exception_name(pdu[1])}"
    problem = parse_pdu(pdu, Direction.RESPONSE).problem
    return _OK if problem is None else f"malformed: {problem}"


def _length(pdu: bytes) -> str:
    return f"{len(pdu) - 2} bytes of values"


def _differing_bytes(pdu: bytes, other: bytes) -> tuple[str, str]:
    """Return two PDUs as short texts in which a difference of the PDUs can be seen.

    Each text shows SHOWN_BYTES bytes: the first ones if the PDUs differ in these, otherwise those
    from the first difference on.
    """
    first = next((at for at, (a, b) in enumerate(zip(pdu, other, strict=False)) if a != b), None)
    if first is None or first < SHOWN_BYTES:
        return _hex_text(pdu), _hex_text(other)
    return f"byte {first}: {_hex_text(pdu[first:])}", f"byte {first}: {_hex_text(other[first:])}"


def _hex_text(pdu: bytes) -> str:
    text = pdu[:SHOWN_BYTES].hex(" ")
    return text if len(pdu) <= SHOWN_BYTES else f"{text} ... ({len(pdu)} bytes)"

"""Replays the requests of a recording as the master, and compares the slave's responses with the
recorded ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import InputError, LinkError, LinkSpec, TcpLink, UsageError, WireEvent
from mbtool.core.moments import SECOND_NS, counted, plural
from mbtool.devices import Difference, DifferenceKind, Span, parse_span, write_reference
from mbtool.master.connections import ConnectionsMaster
from mbtool.master.links import MasterLink, open_master
from mbtool.modbus import Outcome
from mbtool.modbus.response import ConnectionEnding
from mbtool.replay import (
    Conductor,
    PlayClock,
    PlayerControls,
    RequestReport,
    ResponseJudge,
    Script,
    Steering,
    Step,
    Tolerance,
)
from mbtool.replay.connections import Beginning, connection_text
from mbtool.replay.damaged import damaged_answers
from mbtool.replay.script import Action, ConnectionStep
from mbtool.replay.tolerances import Tolerances
from mbtool.views.junit import Case, junit_xml
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.recorded import (
    PlayOptions,
    lateness_p99_ns,
    read_recorded,
    where_none,
    within,
)

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction, Profile

_AT_ONCE_NS = 200_000
"""If the call that sends a request takes less than this (ns), the time before the call counts as
the time of sending; else the time after it."""
_LOOK_NS = 200_000_000
"""The longest interval (ns) between two calls of `stops`, which returns True when the user wants to
end."""
_STEERED_NS = 30_000_000
"""The longest interval (ns) between two checks of the user's keys, if the caller passed `controls`
to read them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterOptions(PlayOptions):
    """The options for replaying a recording as the master, which sends the recorded requests."""

    is_loop: bool = False
    timeout_ns: int = SECOND_NS
    listen_ns: int | None = 0
    """How long to listen for another master on a serial line before the first request, in ns; 0 for
    not at all, None for the usual times."""
    ignore: Sequence[str] = ()
    """Ranges of registers and bits whose values may differ from the recording, as texts such as
    `holding 0..9`."""
    learns: bool = False
    """True if registers whose values differ are collected in `Report.learned` and do not count as
    differences."""
    tolerance: Tolerance | None = None
    tolerate: Sequence[str] = ()
    """By how much values may differ, as texts such as `Temperature=0.5` (replay/tolerances.py)."""
    units: Mapping[int, int] = field(default_factory=dict)
    """The unit to ask in place of a recorded one."""


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The result of replaying a recording as the master; also the content of the JSON report."""

    recording: str
    link: str
    requests: int
    """The number of requests that were sent, repetitions in a loop included."""
    different: int
    """The number of requests whose responses were not as recorded."""
    connections: int = 0
    """The number of TCP connections that were opened, refused or ended and compared with the
    recording."""
    different_connections: int = 0
    """The number of connections that were not refused or ended as recorded."""
    unsolicited: int
    """The number of responses that came while no request of theirs was pending."""
    lateness_p99_ns: int | None
    """The 99th percentile, in ns, of the delays between a request's recorded time and its sending.
    Requests that had to wait for a response are left out. None if there are no others, or if the
    recording was played as fast as possible."""
    asked: list[RequestReport]
    differences: list[Difference]
    learned: list[str] = field(default_factory=list)
    """With --learn, the ranges of registers whose values differed from the recording, as texts for
    --ignore; else empty."""
    damaged: int = 0
    """The number of recorded requests whose answers are not compared, because the recording shows
    them damaged: with a wrong check, in part, malformed or late."""
    uncompared_latencies: int = 0
    """The number of requests whose latencies could not be compared, because they had too few
    responses."""
    not_asked: int = 0
    """The number of requests that were not sent, because the user or an error of the link ended the
    replay; 0 if all were sent once, repetitions in a loop left out."""
    not_awaited: int = 0
    """If the user ended the replay before its end: the number of requests that were sent and whose
    responses were still to come."""
    problem: str | None = None
    """The error that kept some requests from being sent: the slave cannot be reached, or the port
    was lost. None if the link worked."""


class MasterRun:
    """Reads a recording, then sends its requests on a link and compares the responses."""

    def __init__(
        self,
        path: str,
        options: MasterOptions,
        on_remark: Callable[[str], None] = lambda _: None,
        watch: Watch = unwatched,
    ) -> None:
        """Read the recording; if it is cut or damaged, only the part that can be read.

        `on_remark` gets lines for the user about the file. Raises InputError if the file cannot be
        read or has no request to send. Raises UsageError if a unit is on several links, if a
        text in `options.ignore` is no range of registers, if one in `options.tolerate` names no
        point, or if a unit in `options.units` is not asked.
        """
        self._path = path
        self._on_remark = on_remark
        self._options = options

        recorded = read_recorded(path, options, on_remark, watch)
        profiles = recorded.assignments.profiles
        self._profiles: dict[str, Profile] = {each.name: each for each in profiles}
        self._connections = recorded.connections(options, None, on_remark)
        shown = within(recorded.transactions, options.window)
        shown, self.damaged = _without_damage(shown, recorded.damage)
        self.script = Script.of(shown, self._connections)
        if not self.script.steps:
            raise InputError(f"{path}: no request to ask{where_none(options.window)}")
        self._spans = self.spans_of(options.ignore)
        self._values = Tolerances(options.tolerate, self._profiles) if options.tolerate else None
        for recorded_unit in options.units:
            if recorded_unit not in self.script.units:
                known = ", ".join(map(str, sorted(self.script.units)))
                raise UsageError(
                    f"--unit {recorded_unit}={options.units[recorded_unit]}: {path} asks "
                    f"{plural(len(self.script.units), 'unit')} {known}"
                )

    def spans_of(self, texts: Sequence[str]) -> list[Span]:
        """Return ranges of registers, written as for the recording's devices.

        Raises UsageError if a text is no range.
        """
        return [parse_span(text, self._profiles.values()) for text in texts]

    def play(
        self,
        link: LinkSpec,
        *,
        stops: Callable[[], bool] = lambda: False,
        on_answer: Callable[[Step, bytes | None, bool], None] = lambda *_: None,
        on_open: Callable[[], None] = lambda: None,
        controls: PlayerControls | None = None,
    ) -> Report:
        """Send all recorded requests, and compare the responses with the recorded ones.

        Ends early when `stops` returns True. `on_answer` is called for each request with three
        arguments: the recorded request, the PDU of the new response (None if there was none), and
        True if that response is as recorded. `on_open` is called when the link is open. `controls`
        gives the user's keys and shows the progress; None for none.

        If the link cannot be opened or its serial port is lost, the report has the error in
        `problem` and the results so far. Raises UsageError if a master cannot use the link.
        """
        options = self._options
        judge = ResponseJudge(
            profiles=self._profiles,
            spans=self._spans,
            learns=options.learns,
            tolerance=options.tolerance,
            values=self._values,
        )
        clock = PlayClock(
            self.script.length_ns, rate=options.rate, gap_ns=SECOND_NS, is_loop=options.is_loop
        )
        conductor, problem = None, None
        try:
            with self._open(link) as master:
                master.take_line(options.listen_ns)
                has_connections = isinstance(master, ConnectionsMaster)
                conductor = Conductor(
                    self.script, clock, judge, master.limits, with_connections=has_connections
                )
                steering = Steering(clock, conductor.allow_step)
                look_ns = _LOOK_NS if controls is None else _STEERED_NS
                on_open()
                steering.begin(time.monotonic_ns())
                while not conductor.has_ended and not stops():
                    if controls is not None:
                        done = f"{conductor.sent:,} requests, {judge.wrong:,} answered otherwise"
                        steering.update(controls, time.monotonic_ns(), done)
                    self._exchange(master, conductor, judge, on_answer, look_ns)
                if isinstance(master, ConnectionsMaster) and conductor.has_ended:
                    self._judge_open(master, judge)
        except LinkError as error:
            problem = str(error)
        return self._report(link, judge, conductor, problem)

    def _open(self, link: LinkSpec) -> MasterLink:
        options = self._options
        if not self._connections or not isinstance(link, TcpLink) or link.is_udp:
            return open_master(link, options.timeout_ns, self._on_remark)
        master = ConnectionsMaster(link, options.timeout_ns, self._on_remark)
        if self._connections[0].is_open:
            master.open(0, must_open=True)
        return master

    def _take(
        self,
        master: ConnectionsMaster,
        judge: ResponseJudge,
        step: ConnectionStep,
    ) -> None:
        """Open or end a connection as recorded; for an end by the slave, only wait for it."""
        if step.action is Action.OPEN:
            must_open = step.recorded.is_open
            is_open = master.is_open(step.number) or master.open(step.number)
            if not (is_open and must_open):
                told = Beginning.OPENED if is_open else Beginning.REFUSED
                judge.judge_connection(step.number, step.recorded.text, told)
            if is_open and not must_open:
                master.end(step.number, ConnectionEnding.CLOSE)
        elif step.action is Action.CLOSE and step.recorded.ending is not None:
            judge.judge_connection(step.number, step.recorded.text, self._text(master, step))
            master.end(step.number, step.recorded.ending)

    def _judge_ends(
        self, master: ConnectionsMaster, conductor: Conductor, judge: ResponseJudge, now_ns: int
    ) -> None:
        """Judge the awaited end of a connection by the slave, if it or its time-out has come."""
        step = conductor.awaited
        if step is None:
            return
        if master.ended(step.number) is not None:
            conductor.connection_ended(step.number, now_ns)
        elif conductor.overdue_end(now_ns) is None:
            return
        judge.judge_connection(step.number, step.recorded.text, self._text(master, step))
        master.end(step.number, ConnectionEnding.CLOSE)

    def _judge_open(self, master: ConnectionsMaster, judge: ResponseJudge) -> None:
        """Judge the connections that the recording leaves open."""
        for number, one in enumerate(self._connections):
            if one.is_open and not one.ended_by:
                step = ConnectionStep(number, Action.CLOSE, one, 0)
                judge.judge_connection(number, one.text, self._text(master, step))

    def _text(self, master: ConnectionsMaster, step: ConnectionStep) -> str:
        """The words for what became of a connection that was opened, before the master ends it."""
        one, ended = step.recorded, master.ended(step.number)
        if not master.is_open(step.number) and ended is None:
            return one.text  # It was refused, which is judged already.
        if ended is None:
            by_master = one.ended_by == "master"
            return one.text if by_master else connection_text(one.beginning, "", None)
        return connection_text(one.beginning, "slave", ended)

    def _exchange(
        self,
        master: MasterLink,
        conductor: Conductor,
        judge: ResponseJudge,
        on_answer: Callable[[Step, bytes | None, bool], None],
        longest_wait_ns: int,
    ) -> None:
        """Send the next request if it is due; otherwise wait for responses, for at most
        `longest_wait_ns` (ns).

        `on_answer` is called as `play` describes.
        """
        now_ns = time.monotonic_ns()
        if isinstance(master, ConnectionsMaster):
            self._judge_ends(master, conductor, judge, now_ns)
        for number in master.lost():
            for gone, is_right in conductor.give_up(number, now_ns):
                on_answer(gone, None, is_right)
        step = conductor.next_step(now_ns)
        if isinstance(step, ConnectionStep):
            assert isinstance(master, ConnectionsMaster)
            self._take(master, judge, step)
            return
        if step is not None:
            if isinstance(master, ConnectionsMaster):
                master.use(step.connection or 0)
            begin_ns = time.monotonic_ns()
            unit = self._options.units.get(step.unit, step.unit)
            master.send(step.number, unit, step.pdu)
            end_ns = time.monotonic_ns()
            # A slave on this machine may respond before the time `end_ns` is read. A latency
            # counted from `end_ns` would be negative then, so after a short call it counts from
            # `begin_ns`.
            conductor.note_sent(step, begin_ns if end_ns - begin_ns < _AT_ONCE_NS else end_ns)
            return
        wake_ns = conductor.wake_ns(now_ns)
        rest_ns = longest_wait_ns if wake_ns is None else min(wake_ns - now_ns, longest_wait_ns)
        answers = master.receive(max(rest_ns, 0))
        for answer in answers:
            agrees = conductor.answered(*answer)
            if agrees is not None:
                on_answer(self.script.steps[answer.number], answer.pdu, agrees)
        if not answers:
            # If this process was suspended, a response that came in time may be read late. So a
            # request times out only if `now_ns`, read before the wait, is beyond its time-out, and
            # if the wait brought no response.
            for late, is_right in conductor.expire(now_ns):
                on_answer(late, None, is_right)

    def _report(
        self, link: LinkSpec, judge: ResponseJudge, conductor: Conductor | None, problem: str | None
    ) -> Report:
        """Make the report. `conductor` is None if the link could not be opened, so that nothing was
        sent; `problem` is the error of the link, if any.
        """
        options = self._options
        sent = conductor.sent if conductor else 0
        not_asked = max(len(self.script.steps) - sent, 0)
        is_partial = bool(not_asked) or not options.is_loop
        return Report(
            recording=self._path,
            link=str(link),
            requests=sent,
            different=judge.wrong,
            connections=judge.connections,
            different_connections=judge.wrong_connections,
            unsolicited=conductor.unsolicited if conductor else 0,
            lateness_p99_ns=lateness_p99_ns(conductor.lateness, options) if conductor else None,
            asked=judge.requests(),
            differences=judge.differences(),
            learned=[_written(span) for _, span in judge.learned()] if options.learns else [],
            damaged=self.damaged,
            uncompared_latencies=judge.uncompared_latencies(),
            not_asked=not_asked,
            not_awaited=conductor.pending if conductor and is_partial else 0,
            problem=problem,
        )


def _without_damage(
    transactions: Sequence[NamedTransaction], events: Sequence[WireEvent]
) -> tuple[list[NamedTransaction], int]:
    """Return the transactions, with the outcome `not-captured` where the recording shows that the
    answer was damaged, malformed or late, and the number of these.
    """
    ordered = sorted(transactions, key=lambda one: one.start_ns)
    damaged = damaged_answers(ordered, events)
    count = 0
    for index, one in enumerate(ordered):
        if index in damaged or one.outcome in (Outcome.MALFORMED, Outcome.LATE):
            count += one.request_raw is not None
            ordered[index] = msgspec.structs.replace(
                one, outcome=Outcome.NOT_CAPTURED, response_raw=None, latency_ns=None
            )
    return ordered, count


def junit(report: Report) -> str:
    """Return the report as JUnit XML: a test case for each request, one for each register whose
    values differed, and one for each connection that was not refused or ended as recorded.

    A request's case fails if one of its responses was not as recorded, or if its latencies are too
    long. If the link failed or the user ended the replay early, another case has the error.
    """
    cases = [
        Case(
            f"unit {one.unit}",
            request_text(one.what, one.reference),
            [*_counted(one), *one.problems],
            time_ns=one.time_ns,
        )
        for one in report.asked
    ]
    cases += [
        Case(f"unit {each.unit}", f"value of {each.reference}", [_difference_text(each)])
        for each in report.differences
        if each.function is None and each.kind is not DifferenceKind.CONNECTION
    ]
    cases += [
        Case("connections", each.what, [_difference_text(each)])
        for each in report.differences
        if each.kind is DifferenceKind.CONNECTION
    ]
    if report.problem is not None:
        cases.append(Case("link", report.link, error=report.problem))
    elif report.not_asked or report.not_awaited:
        cases.append(Case("replay", "all requests asked", error=interrupted_text(report)))
    return junit_xml(report.recording, cases)


def interrupted_text(report: Report) -> str:
    """Say how far a replay came that the user ended: `interrupted after 1 of 11 requests`."""
    total = report.requests + report.not_asked
    text = f"interrupted after {report.requests:,} of {counted(total, 'request', ',')}"
    if report.not_awaited:
        text += f", {counted(report.not_awaited, 'answer', ',')} not awaited"
    return text


def request_text(what: str, reference: str) -> str:
    """Name a request by its function and addresses, as `03 read holding 0..1`."""
    action, _, table = what.rpartition(" ")
    is_named_twice = reference.startswith(f"{table} ")
    return f"{action if is_named_twice else what} {reference}".rstrip()


def _counted(request: RequestReport) -> list[str]:
    if not request.different:
        return []
    text = f"{request.different:,} of {request.count:,} answers not as recorded"
    if request.registers:
        text = f"{text}; other values in {', '.join(request.registers)}"
    return [text]


def _difference_text(difference: Difference) -> str:
    return f"recorded {difference.a.text}, answered {difference.b.text}"


def _written(span: Span) -> str:
    """A range of registers as text, in the notation that needs no device profile: `holding
    9..19`.
    """
    return write_reference(None, span.table, span.first, span.last - span.first + 1)

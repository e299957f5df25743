"""Tests a slave against its profile and the standard: `mbtool test`."""

# The embedded slave of the profile (slave/device) gives the expected response: it makes the same
# checks in the same order, with the exceptions that the manual documents. So the cases here are
# requests only, each with the section of the standard that it tests. Values are not compared; only
# their number must be right.
#
# Besides correct ADUs, there are cases with wrong bytes: wrong checksums, torn and foreign frames
# on a serial line (Serial Line V1.02); wrong headers, ADUs in pieces and pipelining on TCP (TCP/IP
# Implementation Guide V1.0b). After each of them the unit must answer a correct request.
#
# A deviation that the standard allows, or that many devices share, is a note and not a failure.
#
# The test ends if the unit answers none of MOST_SILENT requests in a row and then no request for a
# sign of life, or if a TCP slave can no longer be reached.
#
# Only addresses that the user names are written, and their values are restored.

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction, LinkError, LinkSpec, SerialFormat, SerialLink, TcpLink
from mbtool.core.limits import LAST_UNIT
from mbtool.core.moments import counted, duration, milliseconds
from mbtool.master.wire import Heard, TcpWire, Wire
from mbtool.modbus import FUNCTIONS, encode_pdu, exception_name, mbap_adu
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.tables import READS_OF_TABLE, Table
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device

if TYPE_CHECKING:
    from mbtool.devices import Profile, Span

_READS = {1: "6.1", 2: "6.2", 3: "6.3", 4: "6.4"}
"""The functions that read, and their sections of the Application Protocol V1.1b3."""
_FILE = "14 07 06 0001 0000 0001"
_OTHERS = tuple(
    bytes.fromhex(text)
    for text in ("07", "0b", "0c", "11", _FILE, "18 0000", "2b 0e 01 00", "41", "63", "6e")
)
"""Requests of functions that a device lacks if its profile does not list them. None writes."""
_LAST = 0xFFFF
_RANDOM_READS = 20
_QUICK_REQUESTS = 20
MOST_SILENT = 3
"""After this many requests in a row without an answer, other requests are sent to see whether the
slave lives."""
_SIGNS = tuple(bytes.fromhex(text) for text in ("08 0000 a55a", "2b 0e 01 00", "04 0000 0001"))
_LATE_NS = 3_000_000_000
"""An answer that does not come in time is waited for this much longer (ns), to tell a late one from
none."""
_LONGEST_PAUSE_NS = 60_000_000
"""A longer pause (ns) inside an answer is the slave's: an adapter delivers bytes at least every 16
ms."""
_RECOVERIES = 8
"""After wrong bytes, right requests are sent until one is answered, at most this many."""
_TRIES = 3
"""The answer to a frame with a pause inside or before it counts only if it is the same each of this
many times: a slave on a busy computer may not see the pause."""
_PAUSE_TRIES = 8
"""An answer counts as one with a pause inside only if it has the pause each of this many times, as
a busy machine makes pauses, too: with 3 times, a machine with 22 processes for 2 cores made a false
one."""
_TORN_TRIES = 8
"""A frame with a pause inside is sent at most this many times: again after a pause that this
machine made too long, and after a wrong answer."""
_TORN_NS = 60_000_000
"""The pause inside a torn frame, in ns: longer than t3.5 at 1200 baud, also on a USB adapter."""
_ASCII_PAUSE_NS = 500_000_000
"""A pause, in ns, that the standard allows inside a frame in ASCII: up to one second."""
_RESOLUTION_NS = 1_000_000
"""A USB adapter sends the bytes that it is given at most this much later (ns). So a pause is tested
only if it is at least this much shorter or longer than t1.5 and t3.5."""
_CONNECTIONS = 8
"""The number of connections that are opened at the same time."""
SILENT_NS = 3_000_000_000
"""The time (ns) for which a TCP connection is left silent before it is used again."""
_FREED_S = 0.1
"""The time (s) between two of at most _RECOVERIES looks at whether the slave serves requests again,
after many connections to it were closed."""


_MOST_LOST = 2
"""On a serial line, a run may lose at most this many requests that are answered when they are sent
again: noise, or a pause of a busy machine inside a request, can lose one."""
_ANSWERS = "the unit answers"
_NO_ANSWER = "no answer"


class Result(StrEnum):
    """How a case ended."""

    PASSED = "passed"
    NOTE = "note"
    """The slave deviates in a way that the standard allows, or that many devices share."""
    FAILED = "failed"


class CaseResult(NamedTuple):
    """One case, and what came of it."""

    name: str
    section: str
    """The section of the standard that the case is about."""
    result: Result
    problem: str
    """What was expected and what came; empty if the case passed."""
    sent: bytes
    heard: bytes
    latency_ns: int


@dataclass(slots=True)
class TestReport:
    """The results of all cases, in the order in which they ran."""

    __test__ = False  # Not a class of tests for pytest.

    cases: list[CaseResult] = field(default_factory=list)

    def count(self, result: Result) -> int:
        return sum(one.result is result for one in self.cases)


class Conformance:
    """Runs the cases for one unit on a wire."""

    def __init__(
        self,
        profile: Profile,
        link: LinkSpec,
        wire: Wire,
        unit: int,
        seed: int = 0,
        *,
        silent_ns: int = SILENT_NS,
        broadcasts: bool = False,
    ) -> None:
        """With `broadcasts`, values are also written to all slaves of the line. A TCP connection is
        left silent for `silent_ns` ns.
        """
        self._profile = profile
        self._link = link
        self._wire = wire
        self._unit = unit
        self._random = random.Random(seed)
        self._model = make_device(profile, RegisterImage())
        """The embedded slave of the profile, which says what should be answered."""
        self._good = self._answered_read()
        self.report = TestReport()
        self._unanswered = 0
        """The number of requests without an answer since the last one."""
        self._lost = 0
        """The number of requests without an answer that were answered when asked again."""
        self._late_ns = _LATE_NS
        self._silent_ns = silent_ns
        self._broadcasts = broadcasts

    def run(
        self,
        writes: Sequence[Span] = (),
        stops: Callable[[], bool] = lambda: False,
    ) -> Iterator[CaseResult]:
        """Run all cases and yield each result; end early when `stops` returns True.

        `writes` are the addresses that may be written. Raises LinkError if a serial port is lost.
        """
        cases = self._all_cases(writes)
        while (result := self._next_result(cases)) is not None:
            self.report.cases.append(result)
            yield result
            if stops():
                return

    def _next_result(self, cases: Iterator[CaseResult]) -> CaseResult | None:
        """Return the result of the next case; None after the last one, or if the unit is gone."""
        try:
            if self._unanswered >= MOST_SILENT and not self._is_alive():
                text = f"no answer to {self._unanswered} requests; the other cases were not run"
            else:
                return next(cases, None)
        except LinkError as error:
            if not isinstance(self._link, TcpLink) or not self.report.cases:
                raise
            text = f"{error}; the other cases were not run"
        if self.report.cases and self.report.cases[-1].name == _ANSWERS:
            return None
        return CaseResult(_ANSWERS, "V1.1b3 4.1", Result.FAILED, text, b"", b"", 0)

    def _is_alive(self) -> bool:
        """True if the unit answers any of the requests that no test is about."""
        for pdu in (self._good, *_SIGNS):
            heard = self._wire.send([self._wire.adu(self._unit, pdu)])
            if heard.raw:
                self._unanswered = 0
                return True
            self._wire.renew()
        return False

    def _all_cases(self, writes: Sequence[Span]) -> Iterator[CaseResult]:
        yield from self._requests()
        if isinstance(self._link, SerialLink):
            yield from self._frames(self._link)
        elif isinstance(self._link, TcpLink) and not self._link.rtu:
            yield from self._headers()
        if isinstance(self._wire, TcpWire):
            yield self.connections(self._wire)
            yield self.after_silence(self._wire)
        for span in writes:
            yield from self._test_writes(span)

    # Requests in correct ADUs. The embedded slave answers them, too: its response is expected.

    def _requests(self) -> Iterator[CaseResult]:
        for name, section, pdu in self._reads():
            yield self._case(name, section, pdu)
        # RTU over TCP has no silences, so a receiver cannot find the end of a PDU of an unknown
        # function.
        has_ends = not (isinstance(self._link, TcpLink) and self._link.rtu)
        for pdu in _OTHERS:
            if self._profile.rule(pdu[0]) is None and (has_ends or pdu[0] in FUNCTIONS):
                yield self._case(f"function {pdu[0]:02X}, which it lacks", "V1.1b3 7, 01", pdu)

    def _reads(self) -> Iterator[tuple[str, str, bytes]]:
        for code, section in _READS.items():
            rule, where = self._profile.rule(code), f"V1.1b3 {section}"
            if rule is None:
                yield f"{code:02X}, which it lacks", "V1.1b3 7, 01", _read(code, 0, 1)
                continue
            limit = FUNCTIONS[code].limit if rule.limit is None else rule.limit
            areas = [area for area in self._profile.areas if READS_OF_TABLE[area.table] == code]
            for area in areas:
                size = area.last - area.first + 1
                yield f"{code:02X} {area.name}: first", where, _read(code, area.first, 1)
                yield f"{code:02X} {area.name}: last", where, _read(code, area.last, 1)
                most = min(size, limit)
                yield f"{code:02X} {area.name}: {most}", where, _read(code, area.first, most)
                if area.last < _LAST:
                    beyond = _read(code, area.last, 2)
                    yield f"{code:02X} {area.name}: one beyond its end", where, beyond
            if areas:
                first = areas[0].first
                yield f"{code:02X} quantity 0", where, _read(code, first, 0)
                yield f"{code:02X} more than {limit}", where, _read(code, first, limit + 1)
                yield f"{code:02X} behind address FFFF", where, _read(code, _LAST, 2)
                for _ in range(_RANDOM_READS):
                    area = self._random.choice(areas)
                    at = self._random.randint(area.first, area.last)
                    most = min(limit, area.last + 1 - at)
                    quantity = self._random.randint(1, most)
                    yield f"{code:02X} {at}, {quantity}", where, _read(code, at, quantity)

    def _case(self, name: str, section: str, pdu: bytes) -> CaseResult:
        sent = self._wire.adu(self._unit, pdu)
        begin_ns = time.monotonic_ns()
        heard = self._wire.send([sent])
        problem = self._problem(pdu, sent, heard, begin_ns)
        is_note = False
        if problem.endswith(_NO_ANSWER) and isinstance(self._link, SerialLink):
            again = self._send_again(sent)
            if again.raw and not self._problem(pdu, sent, again, time.monotonic_ns()):
                problem += ", and the right one when it was asked again"
                self._lost += 1
                is_note = self._lost <= _MOST_LOST
        elif problem:
            self._wire.renew()
        elif self._pauses(pdu, heard):
            problem = f"the answer pauses {milliseconds(heard.longest_pause_ns)} inside"
        return _result(name, section, problem, sent, heard, is_note=is_note)

    def _pauses(self, pdu: bytes, heard: Heard) -> bool:
        """True if the answer pauses inside, and again each time that the request is repeated."""
        for _ in range(_PAUSE_TRIES):
            if heard.longest_pause_ns < _LONGEST_PAUSE_NS:
                return False
            heard = self._send_again(self._wire.adu(self._unit, pdu))
        return True

    def _send_again(self, sent: bytes) -> Heard:
        """Send a request again. A late answer is awaited: the next request would get it."""
        heard = self._wire.send([sent])
        return heard if heard.raw or heard.is_closed else self._wire.hear(self._late_ns)

    def _problem(self, pdu: bytes, sent: bytes, heard: Heard, begin_ns: int) -> str:
        """Compare what came with what the model answers; empty if they agree.

        `begin_ns` is the time at which the request was sent, in ns of the monotonic clock.
        """
        response = self._model.respond(self._unit, pdu, time.monotonic_ns())
        wanted = None if response is None else response.pdu
        if wanted is None:
            return (
                ""
                if not heard.raw
                else f"expected no answer, got {self._wrong_answer_text(heard, pdu)}"
            )
        self._unanswered = 0 if heard.raw else self._unanswered + 1
        got = heard.adus[0] if heard.adus else None
        if got is None:
            late = "" if heard.raw or heard.is_closed else self._late_answer_text(begin_ns)
            return (
                f"expected {_text(wanted, pdu)}, got {late or self._wrong_answer_text(heard, pdu)}"
            )
        if heard.rest:
            return f"expected nothing behind the answer, got {heard.rest.hex(' ')}"
        wrong_id = _wrong_id(sent, heard)
        if wrong_id:
            return wrong_id
        # A device that answers every unit may answer with 0, as FA3 modules do.
        if got.unit != self._unit and not (self._profile.any_unit and got.unit == 0):
            return f"expected unit {self._unit} in the answer, got unit {got.unit}"
        if wanted[0] & EXCEPTION_BIT:
            is_right = got.pdu == wanted
        else:
            expected = ExpectedResponse.of(pdu)
            is_exception = bool(got.pdu[0] & EXCEPTION_BIT)
            is_right = not is_exception and (expected is None or expected.fits(got.pdu))
        if not is_right:
            return f"expected {_text(wanted, pdu)}, got {_text(got.pdu, pdu)}"
        if heard.was_closed:
            return "the slave closed the connection after the answer before"
        return ""

    def _late_answer_text(self, begin_ns: int) -> str:
        """Wait on for an answer that has not come in time; say how late it is, if it comes."""
        heard = self._wire.hear(self._late_ns, begin_ns)
        if not heard.raw:
            self._late_ns = 0 if self._unanswered >= MOST_SILENT else self._late_ns
            return ""
        self._unanswered, self._late_ns = 0, _LATE_NS
        return f"the answer only after {duration(heard.after_ns)}"

    def _answered_read(self) -> bytes:
        """Return the PDU of a read that the profile's device answers with values."""
        for area in self._profile.areas:
            pdu = _read(READS_OF_TABLE[area.table], area.first, 1)
            response = self._model.respond(self._unit, pdu, 0)
            if response is not None and not response.pdu[0] & EXCEPTION_BIT:
                return pdu
        return _read(3, 0, 1)

    # Bytes that no master sends. The embedded slave does not get them; a correct request follows.

    def _frames(self, link: SerialLink) -> Iterator[CaseResult]:
        good = self._wire.adu(self._unit, self._good)
        other = self._unit % LAST_UNIT + 1
        where = "Serial Line V1.02"
        yield self._silent("wrong check", f"{where} 2.5.1.2", [_wrong_check(good, link)])
        yield self._silent(
            "another unit", f"{where} 2.2", [self._wire.adu(other, self._good)],
            note="another device answers there, or this one answers for each unit",
        )  # fmt: skip
        yield self._silent("a read as broadcast", f"{where} 2.1", [self._wire.adu(0, self._good)])
        yield self._silent("half a frame", f"{where} 2.5.1.1", [good[: len(good) // 2]])
        middle = len(good) // 2
        halves = [good[:middle], good[middle:]]
        if not link.ascii:
            yield self._silent(
                "a frame torn in two", f"{where} 2.5.1.1", halves,
                note="it takes two parts with a pause of t3.5 or more for one frame",
                pause_ns=_TORN_NS,
            )  # fmt: skip
            yield from self.pauses_inside(link.format)
            foreign = self._wire.adu(other, bytes.fromhex("03 02 1234"))
            yield self._answered_after_pause(
                "a read behind an answer of another unit", f"{where} 2.4.1", [foreign, good]
            )
            yield self._answered_after_pause(
                "a read behind a stray byte", f"{where} 2.5.1.1", [b"\xff", good]
            )
        else:
            name = f"a frame with a pause of {duration(_ASCII_PAUSE_NS)} inside"
            yield self._answered_after_pause(name, f"{where} 2.5.2.1", halves, _ASCII_PAUSE_NS)
            yield self._answered_after_pause(
                "a read behind half a frame", f"{where} 2.5.2.1", [b":01", good]
            )
        for number in range(_QUICK_REQUESTS):
            yield self._case(f"quick request {number + 1}", f"{where} 2.5.1.1", self._good)

    def pauses_inside(self, line: SerialFormat) -> Iterator[CaseResult]:
        """Send requests with pauses below and above t1.5 inside, if a port can surely make them."""
        good = self._wire.adu(self._unit, self._good)
        halves = [good[: len(good) // 2], good[len(good) // 2 :]]
        where = "Serial Line V1.02 2.5.1.1"
        if line.t1_5_ns > 3 * _RESOLUTION_NS:
            pause = line.t1_5_ns - 2 * _RESOLUTION_NS
            name = "a frame with a pause of less than t1.5 inside"
            yield self._with_pause(name, where, halves, pause, line.t1_5_ns - _RESOLUTION_NS)
        if line.t3_5_ns - line.t1_5_ns > 2 * _RESOLUTION_NS:
            pause = line.t1_5_ns + _RESOLUTION_NS
            name = "a frame with a pause of more than t1.5 inside"
            yield self._with_pause(
                name, where, halves, pause, line.t3_5_ns - _RESOLUTION_NS // 2,
                note="it takes two parts with a pause of more than t1.5 for one frame",
            )  # fmt: skip

    def _with_pause(
        self,
        name: str,
        section: str,
        halves: Sequence[bytes],
        pause_ns: int,
        most_ns: int,
        note: str | None = None,
    ) -> CaseResult:
        """Send a right request with a pause inside; it must be answered, with `note` it must not.

        A busy machine may make a pause longer than `most_ns` ns. What comes of it is not judged,
        and it is sent again.
        """
        judged = 0
        for _ in range(_TORN_TRIES):
            heard = self._wire.send(halves, pause_ns, awaited=note is None)
            is_right = _is_right(heard, self._good) if note is None else not heard.raw
            lasting = self._lasting_problem(forgiven=1)
            is_made = heard.made_pause_ns <= most_ns
            judged += is_made
            if lasting or (is_made and is_right) or judged == _TRIES:
                break
        problem = "" if judged else "this machine could not make the pause exactly; not judged"
        if is_made and not is_right:
            wanted = _text(b"", self._good) if note is None else "no answer"
            problem = f"expected {wanted}, got {self._wrong_answer_text(heard, self._good)}"
        is_note = bool(problem) and (note is not None or not judged) and not lasting
        texts = (problem, note if is_note else "", lasting)
        told = ": ".join(text for text in texts if text)
        return _result(name, section, told, b"".join(halves), heard, is_note=is_note)

    def _headers(self) -> Iterator[CaseResult]:
        where, good = "TCP guide V1.0b", self._good
        for number in (0, 1, _LAST):
            adu = mbap_adu(number, self._unit, good)
            heard = self._wire.send([adu])
            problem = _wrong_id(adu, heard) or self._unless_right(heard, adu)
            yield _result(f"transaction id {number:04X}", f"{where} 3.1.3", problem, adu, heard)
        adu = self._wire.adu(self._unit, good)
        for cut in (1, 6, 7, len(adu) - 1):
            name = f"an ADU in two pieces, {cut} bytes first"
            yield self._answered_after_pause(name, f"{where} 4.4.2.2", [adu[:cut], adu[cut:]])
        both = mbap_adu(0x1111, self._unit, good) + mbap_adu(0x2222, self._unit, good)
        heard = self._wire.send([both], awaited=2)
        ids = [one.transaction_id for one in heard.adus]
        problem = "" if {*ids} == {0x1111, 0x2222} else f"expected both answers, got {_ids(ids)}"
        yield _result("two ADUs in one segment", f"{where} 4.4.2.2", problem, both, heard,
                      is_note=True)  # fmt: skip
        self._wire.renew()
        for name, raw in (
            ("protocol id 1", adu[:2] + b"\x00\x01" + adu[4:]),
            ("length 1", adu[:4] + b"\x00\x01" + adu[6:]),
            ("length 0", adu[:4] + b"\x00\x00" + adu[6:]),
            ("length FFFF", adu[:4] + b"\xff\xff" + adu[6:]),
            ("an ADU that ends in the middle", adu[:9]),
            ("64 random bytes", self._random.randbytes(64)),
        ):
            yield self._silent(name, f"{where} 3.1.3", [raw])
            self._wire.renew()

    def connections(self, wire: TcpWire) -> CaseResult:
        """Open several connections at once and ask on each, and on all of them again.

        The slave may refuse or close some. One that it keeps must be answered, and when all are
        closed it must answer again.
        """
        name, section = f"{_CONNECTIONS} connections at once", "TCP guide V1.0b 4.2.1.2"
        sent = wire.adu(self._unit, self._good)
        opened: list[TcpWire] = []
        problem, is_note = "", False
        heard = wire.send([sent])
        with ExitStack() as stack:
            try:
                for _ in range(_CONNECTIONS - 1):
                    opened.append(stack.enter_context(wire.open_another()))
            except LinkError:
                pass  # The slave has a limit.
            for number, one in enumerate([*opened, wire]):
                if one.is_ended():
                    continue
                heard = one.send([sent])
                if not heard.is_closed and not _is_right(heard, self._good):
                    which = "the first" if one is wire else f"number {number + 2}"
                    problem = (
                        f"{which} of {len(opened) + 1} stays open, and a request on it got "
                        f"{self._wrong_answer_text(heard, self._good)}"
                    )
                    is_note = one is not wire
                    break
            wire.close()
        if is_note:
            problem += ": it serves fewer connections than it accepts"
        for _ in range(_RECOVERIES):
            lasting = self._lasting_problem(forgiven=1)
            if not lasting:
                break
            time.sleep(_FREED_S)
        if lasting:
            problem, is_note = f"{problem}; {lasting}".lstrip("; "), False
        return _result(name, section, problem, sent, heard, is_note=is_note)

    def after_silence(self, wire: TcpWire) -> CaseResult:
        name, section = "a request after a silence", "TCP guide V1.0b 4.3.2"
        silent = duration(self._silent_ns)
        sent = wire.adu(self._unit, self._good)
        wire.send([sent])
        try:
            is_open = wire.stay_silent(self._silent_ns)
        except LinkError as error:
            return _result(name, section, str(error), sent, Heard(b"", (), 0))
        heard = wire.send([sent])
        if not is_open or heard.is_closed or heard.was_closed:
            problem = self._lasting_problem(forgiven=0)
            note = f"it closes a connection that is silent for {silent}"
            return _result(name, section, problem or note, sent, heard, is_note=not problem)
        problem = self._unless_right(heard, sent)
        problem = f"after {silent} of silence {problem}" if problem else ""
        return _result(name, section, problem, sent, heard)

    def _silent(
        self,
        name: str,
        section: str,
        pieces: Sequence[bytes],
        note: str | None = None,
        pause_ns: int = 0,
    ) -> CaseResult:
        """Send bytes that must get no answer, then a request that must get one.

        With `note`, an answer is no failure, and this text says what it means.
        """
        heard = self._wire.send(pieces, pause_ns, awaited=0)
        problem = (
            ""
            if not heard.raw
            else f"expected no answer, got {self._wrong_answer_text(heard, self._good)}"
        )
        is_note = note is not None and bool(problem)
        if is_note:
            problem = f"{problem}: {note}"
        lasting = self._lasting_problem(forgiven=1)
        if lasting:
            problem, is_note = f"{problem}; {lasting}".lstrip("; "), False
        return _result(name, section, problem, b"".join(pieces), heard, is_note=is_note)

    def _answered_after_pause(
        self, name: str, section: str, pieces: Sequence[bytes], pause_ns: int = _TORN_NS
    ) -> CaseResult:
        """Send bytes whose last ones are a right request, with a pause before them."""
        for _ in range(_TRIES):
            heard = self._wire.send(pieces, pause_ns)
            problem = self._unless_right(heard, b"".join(pieces))
            if not problem:
                break
            lasting = self._lasting_problem(forgiven=0)
            problem = f"{problem}; {lasting}" if lasting else problem
        return _result(name, section, problem, b"".join(pieces), heard)

    def _unless_right(self, heard: Heard, sent: bytes) -> str:
        """Say what is wrong with the answer to the right request; nothing if it is right."""
        if not _is_right(heard, self._good):
            got = self._wrong_answer_text(heard, self._good)
            return f"expected {_text(b'', self._good)}, got {got}"
        return _wrong_id(sent, heard)

    def _lasting_problem(self, forgiven: int) -> str:
        """Send right requests until one gets a right answer; say how many did not, if these are
        more than `forgiven`.
        """
        for unanswered in range(_RECOVERIES):
            try:
                self._wire.renew()
            except LinkError as error:
                return f"afterwards {error}"
            if _is_right(self._wire.send([self._wire.adu(self._unit, self._good)]), self._good):
                if unanswered <= forgiven:
                    return ""
                return f"the next {counted(unanswered, 'right request')} got no right answer"
        return "afterwards it answers no right request"

    def _wrong_answer_text(self, heard: Heard, pdu: bytes) -> str:
        """Say what came in place of a right answer to the request with this PDU."""
        if heard.adus:
            return _text(heard.adus[0].pdu, pdu)
        if heard.raw:
            return self._wire.damage(heard.raw, pdu)
        return "the end of the connection" if heard.is_closed else _NO_ANSWER

    # Writes, only where the user allows them.

    def _test_writes(self, span: Span) -> Iterator[CaseResult]:
        reading = READS_OF_TABLE[span.table]
        writing = 5 if span.table.is_bits else 6
        for at in range(span.first, span.last + 1):
            before = self._value(reading, at)
            name = f"{writing:02X} {at}: write, read back, put back"
            section = f"V1.1b3 6.{writing}"
            if before is not None and self._broadcasts:
                yield self.broadcast(span.table, at, before)
            if before is None:
                heard = self._wire.send([self._wire.adu(self._unit, _read(reading, at, 1))])
                yield _result(name, section, "its value cannot be read", b"", heard)
                continue
            changed = before ^ 1
            sent = self._wire.adu(self._unit, _write(writing, at, changed))
            try:
                heard = self._wire.send([sent])
                got = heard.adus[0].pdu if heard.adus else b""
                problem = ""
                request = _write(writing, at, changed)
                if got != request:
                    text = self._wrong_answer_text(heard, request)
                    problem = f"expected the request repeated, got {text}"
                elif (after := self._value(reading, at)) != changed:
                    problem = f"expected {changed} to be read back, got {after}"
            finally:
                self._wire.send([self._wire.adu(self._unit, _write(writing, at, before))])
            if not problem and self._value(reading, at) != before:
                problem = f"{before} could not be put back"
            yield _result(name, section, problem, sent, heard)

    def broadcast(self, table: Table, at: int, before: int) -> CaseResult:
        """Write to all slaves of the line, which must do it and must not answer; put the value
        `before` back.
        """
        reading = READS_OF_TABLE[table]
        writing = 5 if table.is_bits else 6
        sent = self._wire.adu(0, _write(writing, at, before ^ 1))
        try:
            heard = self._wire.send([sent], awaited=0)
            after = self._value(reading, at)
        finally:
            back = self._wire.send([self._wire.adu(0, _write(writing, at, before))], awaited=0)
        problem = ""
        if heard.raw or back.raw:
            shown = self._wrong_answer_text(
                heard if heard.raw else back, _write(writing, at, before ^ 1)
            )
            problem = f"expected no answer, got {shown}"
        elif after != before ^ 1:
            problem = f"expected {before ^ 1} to be read back, got {after}"
        elif (after := self._value(reading, at)) != before:
            problem = f"expected {before} to be put back, got {after}"
        name = f"{writing:02X} {at}: write as broadcast"
        return _result(name, "Serial Line V1.02 2.1", problem, sent, heard)

    def _value(self, reading: int, at: int) -> int | None:
        heard = self._wire.send([self._wire.adu(self._unit, _read(reading, at, 1))])
        pdu = heard.adus[0].pdu if heard.adus else b""
        if len(pdu) < 3 or pdu[0] != reading:
            return None
        return pdu[2] & 1 if reading in (1, 2) else int.from_bytes(pdu[2:4])


def _read(code: int, address: int, quantity: int) -> bytes:
    return bytes([code]) + address.to_bytes(2) + quantity.to_bytes(2)


def _write(code: int, address: int, value: int) -> bytes:
    value = 0xFF00 * value if code == 5 else value
    return encode_pdu(code, Direction.REQUEST, address=address, value=value)


def _wrong_check(adu: bytes, link: SerialLink) -> bytes:
    if link.ascii:
        return adu[:-4] + (b"00" if adu[-4:-2] != b"00" else b"01") + adu[-2:]
    return adu[:-1] + bytes([adu[-1] ^ 0x55])


def _is_right(heard: Heard, pdu: bytes) -> bool:
    expected = ExpectedResponse.of(pdu)
    return bool(heard.adus) and expected is not None and expected.fits(heard.adus[0].pdu)


def _text(response: bytes, pdu: bytes) -> str:
    """Say what a response is: values, or an exception by code and name."""
    if response and response[0] & EXCEPTION_BIT and len(response) == 2:
        text = f"exception {response[1]:02X} {exception_name(response[1])}"
        is_other = bool(pdu) and response[0] != pdu[0] | EXCEPTION_BIT
        return f"{text} with function {response[0]:02X}" if is_other else text
    if pdu and pdu[0] in _READS and (not response or response[0] == pdu[0]):
        quantity = int.from_bytes(pdu[3:5])
        if response and (expected := ExpectedResponse.of(pdu)) and not expected.fits(response):
            more = len(response) - 2 - response[1] if len(response) > 1 else 0
            behind = f" and {counted(more, 'byte')} behind them" if more > 0 else ""
            return f"{counted(len(response) - 2 - max(more, 0), 'byte')} of values{behind}"
        return f"{quantity} value{'s' * (quantity != 1)}"
    return f"{response.hex(' ')}" if response else "an answer"


def _wrong_id(sent: bytes, heard: Heard) -> str:
    """Say that the first answer has another transaction id than the request `sent`; nothing if it
    has the same, or if the link has no such ids.
    """
    got = heard.adus[0].transaction_id if heard.adus else None
    if got in (None, int.from_bytes(sent[:2])):
        return ""
    return f"expected transaction id {sent[:2].hex().upper()} in the answer, got {got:04X}"


def _ids(ids: Sequence[int | None]) -> str:
    return ", ".join("none" if one is None else f"{one:04X}" for one in ids) or "no answer"


def _result(
    name: str, section: str, problem: str, sent: bytes, heard: Heard, *, is_note: bool = False
) -> CaseResult:
    result = Result.PASSED if not problem else Result.NOTE if is_note else Result.FAILED
    return CaseResult(name, section, result, problem, sent, heard.raw, heard.after_ns)

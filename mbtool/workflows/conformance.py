"""Tests a slave against its profile and the standard: `mbtool test`."""

# What a slave should answer is what the embedded slave of its profile answers (slave/device): the
# same checks in the same order, with the exceptions that the manual documents. So the cases here
# are requests only, each with the section of the standard that it is about. Values are not
# compared, only that they are as many as were asked for.
#
# Beside requests in right ADUs there are cases of bytes: wrong checks, torn and foreign frames on a
# serial line (Serial Line V1.02), wrong headers, pieces and pipelining on TCP (TCP/IP
# Implementation Guide V1.0b). After each of them a request must be answered again.
#
# A deviation that the standard allows, or that many devices share, is a note and no failure.
#
# Nothing is written but to the addresses that the user names, whose values are put back.

from __future__ import annotations

import random
import time
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction, SerialLink, TcpLink
from mbtool.core.limits import LAST_UNIT
from mbtool.modbus import FUNCTIONS, encode_pdu, exception_name, mbap_adu
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.modbus.tables import READS_OF_TABLE
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.core import LinkSpec
    from mbtool.devices import Profile, Span
    from mbtool.master.wire import Heard, Wire

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
_TORN_NS = 60_000_000
"""The pause inside a torn frame, in ns: longer than t3.5 at 1200 baud, also on a USB adapter."""


class Result(StrEnum):
    """How a case ended."""

    PASSED = "passed"
    NOTE = "note"
    """It deviates in a way that the standard allows, or that many devices share."""
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
        self, profile: Profile, link: LinkSpec, wire: Wire, unit: int, seed: int = 0
    ) -> None:
        self._profile = profile
        self._link = link
        self._wire = wire
        self._unit = unit
        self._random = random.Random(seed)
        self._model = make_device(profile, RegisterImage())
        """The embedded slave of the profile, which says what should be answered."""
        self._good = self._answered_read()
        self.report = TestReport()

    def run(
        self,
        writes: Sequence[Span] = (),
        stops: Callable[[], bool] = lambda: False,
    ) -> Iterator[CaseResult]:
        """Run all cases and yield each result; end early when `stops` returns True.

        `writes` are the addresses that may be written. Raises LinkError if the link is lost.
        """
        for result in self._all(writes):
            self.report.cases.append(result)
            yield result
            if stops():
                return

    def _all(self, writes: Sequence[Span]) -> Iterator[CaseResult]:
        yield from self._requests()
        if isinstance(self._link, SerialLink):
            yield from self._frames(self._link)
        elif isinstance(self._link, TcpLink) and not self._link.rtu:
            yield from self._headers()
        for span in writes:
            yield from self._written(span)

    # Requests in right ADUs: the model answers them, too, and says what is right.

    def _requests(self) -> Iterator[CaseResult]:
        for name, section, pdu in self._reads():
            yield self._case(name, section, pdu)
        # RTU over TCP has no silences, so nothing tells where a function of no known form ends.
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
        heard = self._wire.send([sent])
        problem = self._problem(pdu, heard)
        return _result(name, section, problem, sent, heard)

    def _problem(self, pdu: bytes, heard: Heard) -> str:
        """Compare what came with what the model answers; empty if they agree."""
        response = self._model.respond(self._unit, pdu, time.monotonic_ns())
        wanted = None if response is None else response.pdu
        if wanted is None:
            return "" if not heard.raw else f"expected no answer, got {_shown(heard, pdu)}"
        got = heard.adus[0] if heard.adus else None
        if got is None:
            return f"expected {_text(wanted, pdu)}, got {_shown(heard, pdu)}"
        if heard.rest:
            return f"expected nothing behind the answer, got {heard.rest.hex(' ')}"
        # A device that answers every unit may answer with 0, as FA3 modules do.
        if got.unit != self._unit and not (self._profile.any_unit and got.unit == 0):
            return f"expected unit {self._unit} in the answer, got unit {got.unit}"
        if wanted[0] & EXCEPTION_BIT:
            is_right = got.pdu == wanted
        else:
            expected = ExpectedResponse.of(pdu)
            is_exception = bool(got.pdu[0] & EXCEPTION_BIT)
            is_right = not is_exception and (expected is None or expected.fits(got.pdu))
        return "" if is_right else f"expected {_text(wanted, pdu)}, got {_text(got.pdu, pdu)}"

    def _answered_read(self) -> bytes:
        """Return the PDU of a read that the profile's device answers with values."""
        for area in self._profile.areas:
            pdu = _read(READS_OF_TABLE[area.table], area.first, 1)
            response = self._model.respond(self._unit, pdu, 0)
            if response is not None and not response.pdu[0] & EXCEPTION_BIT:
                return pdu
        return _read(3, 0, 1)

    # Bytes that no master sends. The model does not see them; a right request follows each.

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
        yield self._silent(
            "a frame torn in two", f"{where} 2.5.1.1", [good[:middle], good[middle:]],
            note="it takes two parts with a pause of t3.5 or more for one frame",
            pause_ns=_TORN_NS,
        )  # fmt: skip
        if not link.ascii:
            foreign = self._wire.adu(other, bytes.fromhex("03 02 1234"))
            yield self._answered("a read behind an answer of another unit", f"{where} 2.4.1",
                                 [foreign, good])  # fmt: skip
            yield self._answered("a read behind a stray byte", f"{where} 2.5.1.1", [b"\xff", good])
        else:
            yield self._answered("a read behind half a frame", f"{where} 2.5.2.1", [b":01", good])
        for number in range(_QUICK_REQUESTS):
            yield self._case(f"quick request {number + 1}", f"{where} 2.5.1.1", self._good)

    def _headers(self) -> Iterator[CaseResult]:
        where, good = "TCP guide V1.0b", self._good
        for number in (0, 1, _LAST):
            adu = mbap_adu(number, self._unit, good)
            heard = self._wire.send([adu])
            ids = [one.transaction_id for one in heard.adus]
            problem = "" if ids == [number] else f"expected id {number:04X}, got {_ids(ids)}"
            yield _result(f"transaction id {number:04X}", f"{where} 3.1.3", problem, adu, heard)
        adu = self._wire.adu(self._unit, good)
        for cut in (1, 6, 7, len(adu) - 1):
            name = f"an ADU in two pieces, {cut} bytes first"
            yield self._answered(name, f"{where} 4.4.2.2", [adu[:cut], adu[cut:]], renews=True)
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
        problem = "" if not heard.raw else f"expected no answer, got {_shown(heard, self._good)}"
        is_note = note is not None and bool(problem)
        if is_note:
            problem = f"{problem}: {note}"
        lasting = self._lasting_problem()
        if lasting:
            problem, is_note = f"{problem}; {lasting}".lstrip("; "), False
        return _result(name, section, problem, b"".join(pieces), heard, is_note=is_note)

    def _answered(
        self, name: str, section: str, pieces: Sequence[bytes], *, renews: bool = False
    ) -> CaseResult:
        """Send bytes whose last ones are a right request, with a pause before them."""
        heard = self._wire.send(pieces, _TORN_NS)
        problem = (
            ""
            if _is_right(heard, self._good)
            else (f"expected {_text(b'', self._good)}, got {_shown(heard, self._good)}")
        )
        if renews and problem:
            self._wire.renew()
        return _result(name, section, problem, b"".join(pieces), heard)

    def _lasting_problem(self) -> str:
        """Return what is wrong if a right request gets no right answer any more; else nothing."""
        for _ in range(2):
            self._wire.renew()
            if _is_right(self._wire.send([self._wire.adu(self._unit, self._good)]), self._good):
                return ""
        return "afterwards it answers no right request"

    # Writes, only where the user allows them.

    def _written(self, span: Span) -> Iterator[CaseResult]:
        reading = READS_OF_TABLE[span.table]
        writing = 5 if span.table.is_bits else 6
        for at in range(span.first, span.last + 1):
            before = self._value(reading, at)
            name = f"{writing:02X} {at}: write, read back, put back"
            section = f"V1.1b3 6.{writing}"
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
                if got != _write(writing, at, changed):
                    problem = f"expected the request repeated, got {_shown(heard, b'')}"
                elif (after := self._value(reading, at)) != changed:
                    problem = f"expected {changed} to be read back, got {after}"
            finally:
                self._wire.send([self._wire.adu(self._unit, _write(writing, at, before))])
            if not problem and self._value(reading, at) != before:
                problem = f"{before} could not be put back"
            yield _result(name, section, problem, sent, heard)

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
        return f"exception {response[1]:02X} {exception_name(response[1])}"
    if pdu and pdu[0] in _READS and (not response or response[0] == pdu[0]):
        quantity = int.from_bytes(pdu[3:5])
        if response and (expected := ExpectedResponse.of(pdu)) and not expected.fits(response):
            return f"{len(response) - 2} bytes of values"
        return f"{quantity} value{'s' * (quantity != 1)}"
    return f"{response.hex(' ')}" if response else "an answer"


def _shown(heard: Heard, pdu: bytes) -> str:
    if heard.adus:
        return _text(heard.adus[0].pdu, pdu)
    if heard.raw:
        return f"bytes that are no ADU: {heard.raw[:32].hex(' ')}"
    return "the end of the connection" if heard.is_closed else "no answer"


def _ids(ids: Sequence[int | None]) -> str:
    return ", ".join("none" if one is None else f"{one:04X}" for one in ids) or "no answer"


def _result(
    name: str, section: str, problem: str, sent: bytes, heard: Heard, *, is_note: bool = False
) -> CaseResult:
    result = Result.PASSED if not problem else Result.NOTE if is_note else Result.FAILED
    return CaseResult(name, section, result, problem, sent, heard.raw, heard.after_ns)

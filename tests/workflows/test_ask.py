"""A slave that is asked: what is told of each request, and what has changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.core import EventKind, SerialLink, TcpLink
from mbtool.devices import load_profile
from mbtool.master.links import Exchange, MasterLink, ReceivedResponse, open_master
from mbtool.modbus import Outcome, Response, Skipped, rtu_adu
from mbtool.modbus.adu import Transport
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.virtual_line import VirtualLine
from mbtool.views.cells import transaction_text
from mbtool.workflows.ask import Asker, Changes, PollTally
from tests.slave.scripted import Scripted
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.bench import ANY, FAST
from tests.workflows.evidence import READ, REFUSED, VALUES, WRITE

if TYPE_CHECKING:
    from collections.abc import Sequence

FT1A = load_profile("idec-ft1a-touch")
READ_COILS = bytes.fromhex("01 0000 0003")


class Answers:
    """Gives one answer after the other, and the last one from then on."""

    def __init__(self, *pdus: str) -> None:
        self._left = [bytes.fromhex(pdu) for pdu in pdus]

    def __call__(self, _unit: int, _pdu: bytes) -> Response | None:
        pdu = self._left.pop(0) if len(self._left) > 1 else self._left[0]
        return Response(pdu) if pdu else None


def test_a_transaction_has_the_names_of_the_device() -> None:
    script = Scripted(lambda _unit, pdu: Response(VALUES if pdu == READ else REFUSED))
    with TcpSlave(TcpLink(ANY), script) as slave:
        link = TcpLink(slave.endpoint)
        with open_master(link, MASTER_TIMEOUT_NS) as master:
            asker = Asker(master, link, 1, FT1A)
            read, nothing = asker.ask(READ)
            refused, _ = asker.ask(bytes.fromhex("03 1000 0001"))
    assert nothing == []
    assert (read.reference, read.response_values) == ("HR400001..400002", [0x1234, 0x5678])
    assert read.latency_ns is not None
    assert 1_600_000_000_000_000_000 < (read.request_ns or 0) <= (read.response_ns or 0)
    assert refused.outcome is Outcome.EXCEPTION
    assert "FT1A-A3" in refused.findings


class NoisyLink(MasterLink):
    """Gets bytes that are no response, and nothing else."""

    def exchange(self, unit: int, pdu: bytes) -> Exchange:
        self.transport = Transport.RTU
        self._note_request(unit, pdu, rtu_adu(unit, pdu))
        noise = Skipped(self._request.end_ns, EventKind.BAD_CHECK, "wrong CRC", b"\1\2")
        return Exchange(self._request, None, (noise,))

    def send(self, number: int, unit: int, pdu: bytes) -> None: ...

    def receive(self, timeout_ns: int) -> Sequence[ReceivedResponse]:
        return ()

    def close(self) -> None: ...


def test_bytes_that_are_no_response_are_events() -> None:
    link = SerialLink("/dev/rs485", FAST)
    transaction, (event,) = Asker(NoisyLink(), link, 1, None).ask(READ)
    assert transaction.outcome is Outcome.NO_ANSWER
    assert (event.kind, event.raw) == (EventKind.BAD_CHECK, b"\1\2")
    assert event.message == "2 bytes: wrong CRC"
    assert event.ts_ns == transaction.request_ns


def test_only_what_changes_is_told_after_the_first_time() -> None:
    answers = Answers("03 04 0001 0002", "03 04 0001 0002", "03 04 0001 0003", "83 02")
    assert _texts(READ, answers, 4) == [
        "03 read HR400001..400002 -> 1, 2",
        None,
        "03 read HR400001..400002 -> HR400002: 3 (was 2)",
        "03 read HR400001..400002 -> 02 illegal data address",
    ]


def test_an_answer_that_stays_away_is_told_once() -> None:
    asker, changes = Asker(NoisyLink(), SerialLink("/dev/rs485", FAST), 1, None), Changes(None)
    first, second = (changes.since_last(READ, asker.ask(READ)[0]) for _ in range(2))
    assert first is not None
    assert transaction_text(first) == "03 read holding 0..1 -> no answer"
    assert second is None


def test_a_bit_that_falls_is_told() -> None:
    assert _texts(READ_COILS, Answers("01 01 05", "01 01 04"), 2) == [
        "01 read C1..3 -> 1 0 1",
        "01 read C1..3 -> C1: 0 (was 1)",
    ]


def test_named_values_are_told_by_their_names() -> None:
    read = bytes.fromhex("03 00F5 0001")
    texts = _texts(read, Answers("03 02 0007", "03 02 0008"), 2, "fa3-th1m16y")
    assert texts[1] == "03 read 00F5H -> Split reception monitoring timer: 8 s (was 7 s)"


def _texts(
    pdu: bytes, answers: Answers, count: int, device: str = "idec-ft1a-touch"
) -> list[str | None]:
    """The rows of a table of changes; None where there is none."""
    profile = load_profile(device)
    changes = Changes(profile)
    with TcpSlave(TcpLink(ANY), Scripted(answers)) as slave:
        link = TcpLink(slave.endpoint)
        with open_master(link, MASTER_TIMEOUT_NS) as master:
            asker = Asker(master, link, 1, profile)
            changed = [changes.since_last(pdu, asker.ask(pdu)[0]) for _ in range(count)]
    return [None if one is None else transaction_text(one) for one in changed]


def test_the_tally_counts_by_outcome_with_the_latencies() -> None:
    tally = PollTally()
    assert tally.sentence() == "asked 0, answered 0, failed 0"
    with TcpSlave(TcpLink(ANY), Scripted(Answers("03 02 0001", "83 02"))) as slave:
        link = TcpLink(slave.endpoint)
        with open_master(link, MASTER_TIMEOUT_NS) as master:
            asker = Asker(master, link, 1, None)
            for _ in range(2):
                tally.add(asker.ask(bytes.fromhex("03 0000 0001"))[0])
    tally.add(Asker(NoisyLink(), SerialLink("/dev/rs485", FAST), 1, None).ask(READ)[0])
    assert tally.failed == 2
    said = tally.sentence()
    assert said.startswith("asked 3, answered 1, failed 2 (1 exception, 1 no-answer); latency ")
    assert said.endswith(" at most")


def test_a_broadcast_is_no_failure() -> None:
    tally = PollTally()
    with VirtualLine(ends=2, format=FAST) as line:
        slave, link = (SerialLink(port, FAST) for port in line.ports)
        with (
            SerialSlave(slave, Scripted(lambda _unit, _pdu: None)),
            open_master(link, MASTER_TIMEOUT_NS) as master,
        ):
            tally.add(Asker(master, link, 0, None).ask(WRITE)[0])
    assert tally.sentence() == "asked 1, answered 1, failed 0"


def test_an_answer_of_another_length_is_shown_whole() -> None:
    changes = Changes(None)
    lengths = iter((b"\x03\x04\x00\x01\x00\x02", b"\x03\x02\x00\x09"))
    with TcpSlave(TcpLink(ANY), Scripted(lambda unit, pdu: Response(next(lengths)))) as slave:
        link = TcpLink(slave.endpoint)
        with open_master(link, MASTER_TIMEOUT_NS) as master:
            asker = Asker(master, link, 1, None)
            first, second = (asker.ask(READ)[0] for _ in range(2))
    second = msgspec.structs.replace(second, outcome=first.outcome)
    assert changes.since_last(READ, first) is first
    told = changes.since_last(READ, second)
    assert told is not None
    assert [point.text for point in told.points] == ["9"]

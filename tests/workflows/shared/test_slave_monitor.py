"""Exchanges of a slave as transactions, and its outputs."""

from __future__ import annotations

import pytest

from mbtool.core import Direction, EventKind, WireEvent, parse_link
from mbtool.devices import NamedTransaction, load_profile
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.modbus import Outcome, Response, mbap_adu, rtu_adu
from mbtool.modbus.adu import Adu
from mbtool.modbus.response import ConnectionEnding, Distortion
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device
from mbtool.workflows.shared.slave_monitor import MAX_PENDING, SlaveMonitor

TOUCH = load_profile("idec-ft1a-touch")
READ = bytes.fromhex("03 0000 0001")
VALUE = bytes.fromhex("03 02 1234")


def _tcp() -> SlaveMonitor:
    return SlaveMonitor(TOUCH, parse_link("tcp:127.0.0.1:1502"))


def _request(unit: int = 1) -> Adu:
    (adu,) = MbapSplitter(Direction.REQUEST).feed(mbap_adu(7, unit, READ), 1_000)
    assert isinstance(adu, Adu)
    return adu


def _transactions(monitor: SlaveMonitor) -> list[NamedTransaction]:
    """The transactions of what has come, without the events."""
    return [one for one in monitor.records() if not isinstance(one, WireEvent)]


def test_an_exchange_is_a_transaction_in_the_devices_words() -> None:
    monitor = _tcp()
    monitor.take(_request(), Response(VALUE, delay_ns=5_000_000))
    (transaction,) = _transactions(monitor)
    assert transaction.outcome is Outcome.OK
    assert (transaction.device, transaction.reference) == ("idec-ft1a-touch", "HR400001")
    assert (transaction.response_values, transaction.latency_ns) == ([0x1234], 5_000_000)
    assert transaction.response_raw == mbap_adu(7, 1, VALUE)
    assert monitor.profile_for(transaction) is TOUCH
    assert _transactions(monitor) == []


def test_silence_and_a_spoilt_answer_that_is_not_sent_are_no_answer() -> None:
    monitor = _tcp()
    monitor.take(_request(), None)
    monitor.take(_request(), Response(VALUE, distortion=Distortion(silent=True)))
    assert [one.outcome for one in _transactions(monitor)] == [Outcome.NO_ANSWER] * 2


def test_a_spoilt_answer_is_shown_as_it_left() -> None:
    monitor = _tcp()
    monitor.take(_request(), Response(VALUE, distortion=Distortion(cut=1, pieces=2, gap_ns=3)))
    (transaction,) = _transactions(monitor)
    assert transaction.response_raw == mbap_adu(7, 1, VALUE)[:-1]
    assert transaction.response_ns == 1_003


@pytest.mark.parametrize(
    ("spoiling", "says"),
    [
        (Distortion(wrong_check=True), "a wrong checksum"),
        (Distortion(unit_by=1, id_by=1), "another unit, another transaction id"),
        (Distortion(cut=2, extra=b"abc"), "bytes missing at its end (2), more bytes behind it (3)"),
        (Distortion(pieces=3, gap_ns=1), "in 3 pieces"),
        (Distortion(ending=ConnectionEnding.CLOSE), "connection closed"),
        (Distortion(silent=True, cut=1), "not sent"),
        (Distortion(silent=True, ending=ConnectionEnding.RESET), "not sent, connection reset"),
    ],
)
def test_behind_a_spoilt_answer_stands_what_was_done_to_it(spoiling: Distortion, says: str) -> None:
    monitor = _tcp()
    monitor.take(_request(), Response(VALUE, delay_ns=5, distortion=spoiling))
    monitor.take(_request(), Response(VALUE))
    _, event, good = monitor.records()
    assert isinstance(event, WireEvent)
    assert (event.kind, event.ts_ns) == (EventKind.SPOILT, 1_005)
    assert event.message == f"the answer above, on purpose: {says}"
    assert not isinstance(good, WireEvent)


def test_behind_a_request_that_was_never_recorded_stands_that_it_was_not() -> None:
    monitor = SlaveMonitor(TOUCH, parse_link("tcp:127.0.0.1:1502"), is_recorded=lambda *_: False)
    monitor.take(_request(), Response(VALUE))
    _, event = monitor.records()
    assert isinstance(event, WireEvent)
    assert (event.kind, event.message) == (
        EventKind.UNRECORDED, "the request above was never recorded",
    )  # fmt: skip


def test_unit_0_is_a_broadcast_on_a_line_only() -> None:
    serial = SlaveMonitor(TOUCH, parse_link("rtu+tcp:127.0.0.1:1502"))
    (adu,) = RtuStreamSplitter(Direction.REQUEST).feed(rtu_adu(0, READ), 1_000)
    assert isinstance(adu, Adu)
    serial.take(adu, None)
    tcp = _tcp()
    tcp.take(_request(unit=0), None)
    outcomes = [_transactions(each)[0].outcome for each in (serial, tcp)]
    assert outcomes == [Outcome.BROADCAST, Outcome.NO_ANSWER]


def test_what_nobody_takes_is_bounded_and_counted() -> None:
    monitor = _tcp()
    for _ in range(MAX_PENDING + 3):
        monitor.take(_request(), Response(VALUE))
    assert monitor.missed() == 3
    assert monitor.missed() == 0
    assert len(_transactions(monitor)) == MAX_PENDING


def test_outputs_are_told_when_they_change() -> None:
    profile = load_profile("fa3-th1m16y")
    device = make_device(profile, RegisterImage.of(profile))
    monitor = SlaveMonitor(profile, parse_link("tcp:127.0.0.1:1502"))
    assert monitor.changed_outputs() == []
    monitor.begin({1: device.behaviour})
    assert device.behaviour.rules is not None
    device.behaviour.rules.admit("127.0.0.1", 0)
    assert monitor.changed_outputs() == []
    device.respond(0, bytes.fromhex("05 0003 FF00"), 0)
    assert [(one.name, one.text) for one in monitor.changed_outputs()] == [("Y3", "on")]
    assert monitor.changed_outputs() == []


def test_of_several_devices_each_has_its_own_words_and_its_unit_at_its_outputs() -> None:
    module = load_profile("fa3-th1m16y")
    device = make_device(module, RegisterImage.of(module))
    touch = make_device(TOUCH, RegisterImage.of(TOUCH))
    monitor = SlaveMonitor(TOUCH, parse_link("tcp:127.0.0.1:1502"), {3: module})
    monitor.begin({1: touch.behaviour, 3: device.behaviour})
    monitor.take(_request(), Response(VALUE))
    monitor.take(_request(unit=3), Response(VALUE))
    shown = [(one.device, one.reference) for one in _transactions(monitor)]
    assert shown == [("idec-ft1a-touch", "HR400001"), ("fa3-th1m16y", "RWw0")]
    assert device.behaviour.rules is not None
    device.behaviour.rules.admit("127.0.0.1", 0)
    device.respond(3, bytes.fromhex("05 0003 FF00"), 0)
    assert [one.name for one in monitor.changed_outputs()] == ["unit 3 Y3"]

"""Runs of the sniffer on links that are real, but have no hardware."""

from __future__ import annotations

import os
import socket
import time
from collections import Counter
from contextlib import ExitStack, suppress
from functools import partial
from itertools import islice
from threading import Thread
from typing import TYPE_CHECKING
from unittest.mock import Mock

import pytest

from mbtool.core import (
    Chunk,
    Direction,
    Endpoint,
    EventKind,
    LinkError,
    LinkSpec,
    OutputError,
    Quiet,
    SerialFormat,
    SerialLink,
    TapLink,
    TargetTls,
    UsageError,
    WireEvent,
    parse_link,
)
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, NamedTransaction, Namer
from mbtool.logs import LogReader, follow
from mbtool.logs.opening import create_log
from mbtool.modbus import Outcome, Verdict, encode_pdu, mbap_adu
from mbtool.sources.serial_capture import SerialSource
from mbtool.sources.tap import TapSource
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.sniff import Sniffer, serial_lines
from tests.certificates import CA, STRANGER, slave_context
from tests.cli.program import patient
from tests.records import without_origins
from tests.sources.live_helpers import PATIENCE_S, stop_marking
from tests.workflows.bench import ANY, Bench, ask, call_in_vain, speak, until
from tests.workflows.evidence import READ, VALUES, WRITE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from mbtool.decode.decoder import Record
    from mbtool.logs.messages import DecodingMark, LogItem


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as one:
        yield one


def _sniffer(*links: LinkSpec, log: Path | None = None, **more: object) -> Sniffer:
    decoder = Decoder(Namer(), lines=serial_lines(links))
    begin = partial(create_log, str(log), links, Assignments()) if log is not None else None
    return Sniffer(links, decoder, begin_log=begin, **more)  # type: ignore[arg-type]


def _transactions(records: list[Record]) -> list[NamedTransaction]:
    return [record for record in records if isinstance(record, NamedTransaction)]


def _run(sniffer: Sniffer, count: int) -> list[Record]:
    """Records until there are so many transactions."""
    records: list[Record] = []
    stop = until(records, lambda found: len(_transactions(found)) >= count)
    for record in sniffer.records(stop):
        records.append(record)
    return records


def test_hears_a_relay_and_logs_it(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with _sniffer(bench.tap(), log=path) as sniffer:
        ask(sniffer, WRITE, count=3)
        records = _run(sniffer, 3)
    assert [one.request_values for one in _transactions(records)] == [[7]] * 3
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert without_origins(logged) == records
    raw = list(Reading([str(path)], ReadingOptions(raw=True)).records())
    assert _transactions(raw) == _transactions(logged)
    with LogReader.open(path) as log:
        list(log.items())
        assert log.closed
        assert log.capture["discarded_packets"] == log.capture["discarded_bytes"] == "0"


def test_requests_over_the_limit_are_told_as_such_and_not_as_unanswered() -> None:
    """A master sends all its requests before the slave answers, through a tap with sockets."""
    count = 4 * MAX_OPEN_REQUESTS
    requests, responses = (
        [mbap_adu(at, 1, encode_pdu(3, direction, **fields(at))) for at in range(count)]
        for direction, fields in (
            (Direction.REQUEST, lambda at: {"address": at, "quantity": 1}),
            (Direction.RESPONSE, lambda at: {"values": (at,)}),
        )
    )
    remarks: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        tap = TapLink(ANY, Endpoint(*server.getsockname()))
        with _sniffer(tap, on_remark=remarks.append) as sniffer:
            (source,) = sniffer.sources
            assert isinstance(source, TapSource)
            listening = (source.endpoint.host, source.endpoint.port)
            with socket.create_connection(listening, PATIENCE_S) as master:
                slave, _ = server.accept()
                with slave:
                    master.sendall(b"".join(requests))
                    _read(slave, sum(map(len, requests)))
                    slave.sendall(b"".join(responses))
                    _read(master, sum(map(len, responses)))
                records = _run(sniffer, 2 * count - MAX_OPEN_REQUESTS)
    dropped = count - MAX_OPEN_REQUESTS
    done = _transactions(records)
    assert Counter((one.outcome, one.request_raw is None, *one.verdicts) for one in done) == {
        (Outcome.NOT_CAPTURED, False, Verdict.OVER_LIMIT): dropped,
        (Outcome.NOT_CAPTURED, True, Verdict.OVER_LIMIT): dropped,
        (Outcome.OK, False): MAX_OPEN_REQUESTS,
    }
    assert all([one.address] == one.response_values for one in done if one.outcome is Outcome.OK)
    assert remarks == [
        f"{dropped} requests not joined with the answer: "
        f"more than {MAX_OPEN_REQUESTS} were open at once"
    ]


def _read(connection: socket.socket, count: int) -> None:
    connection.settimeout(PATIENCE_S)
    while count:
        count -= len(connection.recv(min(count, 1 << 16)))


def test_the_log_is_begun_before_a_tap_lets_anybody_in(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    accept = TapSource.accept

    def noted(tap: TapSource) -> None:
        done.append("accepts")
        accept(tap)

    monkeypatch.setattr(TapSource, "accept", noted)
    links = [bench.tap()]

    def begin() -> Mock:
        done.append("log")
        return Mock()

    with Sniffer(links, Decoder(Namer()), begin_log=begin) as sniffer:
        assert done == ["log", "accepts"]
        ask(sniffer, WRITE)
        assert len(_run(sniffer, 1)) >= 1


def test_hears_a_serial_line_and_logs_it(bench: Bench, tmp_path: Path) -> None:
    link, descriptor = bench.line(tmp_path)
    path = tmp_path / "a.mcap"
    with _sniffer(link, log=path) as sniffer:
        speak(descriptor, READ)
        speak(descriptor, VALUES)
        records = _run(sniffer, 1)
        # What is heard after the last look is logged all the same.
        speak(descriptor, WRITE)
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert without_origins(logged)[0] == records[0]
    assert list(Reading([str(path)], ReadingOptions(raw=True)).records()) == logged


def test_hears_several_links_at_once(bench: Bench, tmp_path: Path) -> None:
    link, descriptor = bench.line(tmp_path)
    tap = bench.tap()
    with _sniffer(link, tap) as sniffer:
        speak(descriptor, WRITE)
        speak(descriptor, WRITE)
        ask(sniffer, WRITE)
        records = _run(sniffer, 2)
    assert {one.link for one in _transactions(records)} == {link.name, tap.name}


def test_a_slave_that_cannot_be_reached_is_told_once_and_logged_each_time(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    tap = bench.refusing_tap()
    told: list[str] = []
    records: list[Record] = []
    with _sniffer(tap, log=path, on_remark=told.append) as sniffer:
        call_in_vain(sniffer, 3)
        stop = until(records, lambda found: len(found) >= 3)
        for record in sniffer.records(stop):
            records.append(record)
    events = [one for one in records if isinstance(one, WireEvent)]
    assert [one.kind for one in events] == [EventKind.REFUSED] * 3
    why = f"{tap.target} cannot be reached: Connection refused"
    assert {one.message for one in events} == {why}
    assert told == [f"a master was turned away: {why}"]
    assert list(Reading([str(path)], ReadingOptions()).records()) == records


def test_a_target_that_no_name_leads_to_is_told_before_a_master_comes() -> None:
    told: list[str] = []
    tap = TapLink(ANY, Endpoint("no..host", 502))
    with _sniffer(tap, on_remark=told.append) as sniffer:
        assert list(sniffer.records(until([], lambda _: bool(told)))) == []
    assert told == ["no..host: no such host; masters are refused until there is one"]


def test_a_slave_that_refuses_the_tap_behind_the_handshake_is_told_once() -> None:
    """With TLS 1.3 each connection opens first."""
    told: list[str] = []
    records: list[Record] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        target = Endpoint(*server.getsockname())
        tap = TapLink(ANY, target, target_tls=TargetTls(CA, STRANGER))
        with _sniffer(tap, on_remark=told.append) as sniffer:
            slave = Thread(target=_refuse_certificates, args=(server, 3))
            slave.start()
            call_in_vain(sniffer, 3)
            slave.join(PATIENCE_S)
            for record in sniffer.records(until(records, lambda found: len(found) >= 9)):
                records.append(record)
    kinds = [one.kind for one in records if isinstance(one, WireEvent)]
    assert kinds == [EventKind.OPENED, EventKind.REFUSED, EventKind.CLOSED] * 3
    _, refusal, *_ = records
    assert isinstance(refusal, WireEvent)
    assert told == [f"a master was turned away: {refusal.message}"]


def _refuse_certificates(server: socket.socket, count: int) -> None:
    context = slave_context(ca=CA)
    for _ in range(count):
        connection, _ = server.accept()
        with connection, suppress(OSError):
            context.wrap_socket(connection, server_side=True)


def test_says_where_a_tap_listens_that_asked_for_any_port(bench: Bench) -> None:
    tap = bench.tap()
    with _sniffer(tap) as sniffer:
        (place,) = sniffer.places
        opened = parse_link(place)
    assert isinstance(opened, TapLink)
    assert (opened.listen.host, opened.target) == ("127.0.0.1", tap.target)
    assert opened.listen.port != 0


def test_a_reader_that_leaves_early_leaves_a_complete_log(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with _sniffer(bench.tap(), log=path) as sniffer:
        ask(sniffer, WRITE, count=20)
        next(sniffer.records(until([], lambda _: False)))
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert len(_transactions(logged)) == 20
    assert isinstance(logged[-1], WireEvent)
    with LogReader.open(path) as log:
        list(log.items())
        assert log.closed


def test_a_reader_that_leaves_in_the_rest_leaves_a_complete_log(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with _sniffer(bench.tap(), log=path) as sniffer:
        ask(sniffer, WRITE, count=20)
        next(sniffer.records(lambda _: True))
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert len(_transactions(logged)) == 20


def test_a_caller_in_a_hurry_leaves_the_decoding_to_whoever_reads_the_log(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.workflows.sniff.HURRY_NS", -1)
    whole, left = tmp_path / "whole.mcap", tmp_path / "left.mcap"
    told: list[str] = []
    for path, is_hurried in ((whole, False), (left, True)):
        with _sniffer(bench.tap(), log=path, on_remark=told.append) as sniffer:
            ask(sniffer, WRITE, count=20)
            given = list(sniffer.records(lambda _: True, partial(bool, is_hurried)))
            assert bool(given) is not is_hurried
    assert told == [
        "40 pieces of what was heard not decoded, for lack of time; "
        "reading the log decodes all of it"
    ]
    reading = Reading([str(left)], ReadingOptions())
    found = list(reading.records())
    assert reading.remarks == [
        f"{left}: 40 pieces not decoded when it was made; it is decoded again"
    ]
    expected = list(Reading([str(whole)], ReadingOptions()).records())
    assert [one.request_values for one in _transactions(found)] == [[7]] * 20
    assert len(_transactions(found)) == len(_transactions(expected))
    with LogReader.open(left) as log:
        assert not list(log.transactions())
        assert log.capture["undecoded_pieces"] == "40"


def test_a_loss_is_told_though_nothing_is_decoded_any_more(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.workflows.sniff.HURRY_NS", -1)
    told: list[str] = []
    path = tmp_path / "a.mcap"
    with _sniffer(bench.tap(), log=path, on_remark=told.append) as sniffer:
        ask(sniffer, WRITE, count=20)
        sniffer._inbox.put(
            WireEvent(
                ts_ns=1, link="net:a", kind=EventKind.DISCARDED, message="7 packets lost", packets=7
            )
        )
        assert not list(sniffer.records(lambda _: True, lambda: True))
    assert told[0] == "net:a: 7 packets lost"
    with LogReader.open(path) as log:
        assert [one.packets for one in log.items() if isinstance(one, WireEvent) and one.packets]
        assert log.capture["discarded_packets"] == "7"


def test_a_link_is_recorded_though_nobody_asks_for_records(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with _sniffer(bench.tap(), log=path) as sniffer:
        ask(sniffer, WRITE, count=20)
        heard = (item for item in follow(path, patient()) if isinstance(item, Chunk))
        assert len(list(islice(heard, 40))) == 40
    logged = list(Reading([str(path)], ReadingOptions()).records())
    assert len(_transactions(logged)) == 20


def test_an_exception_of_the_reader_leaves_a_complete_log(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    def read_and_fail() -> None:
        with _sniffer(bench.tap(), log=path) as sniffer:
            ask(sniffer, WRITE)
            for _ in sniffer.records(until([], lambda _: False)):
                raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        read_and_fail()
    assert _transactions(list(Reading([str(path)], ReadingOptions()).records()))


def test_a_port_that_is_not_there_leaves_no_log_and_no_process(
    bench: Bench, tmp_path: Path
) -> None:
    link, _ = bench.line(tmp_path)
    path = tmp_path / "a.mcap"
    sniffer = _sniffer(link, SerialLink(str(tmp_path / "absent"), link.format), log=path)
    with pytest.raises(LinkError, match="absent: is not there"):
        sniffer.__enter__()
    assert not path.exists()
    (opened,) = sniffer.sources
    assert isinstance(opened, SerialSource)
    assert opened._child is not None
    assert opened._child.poll() is not None


def test_a_log_that_cannot_be_begun_closes_the_links(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    tap = bench.tap()
    sniffer = _sniffer(tap, log=path)
    with pytest.raises(UsageError, match="the file exists"):
        sniffer.__enter__()
    place = parse_link(sniffer.places[0])
    assert isinstance(place, TapLink)
    # The port is free again.
    with _sniffer(TapLink(place.listen, tap.target)):
        pass


def test_a_link_that_goes_away_is_told_and_the_others_stay(bench: Bench, tmp_path: Path) -> None:
    lost: list[str] = []
    records: list[Record] = []
    asked = False

    def is_enough(found: list[Record]) -> bool:
        nonlocal asked
        if lost and not asked:
            asked = True
            ask(sniffer, WRITE)
        return bool(_transactions(found))

    with Bench() as other:
        link, _ = other.line(tmp_path)
        with _sniffer(link, bench.tap(), on_remark=lost.append) as sniffer:
            other.close()
            for record in sniffer.records(until(records, is_enough)):
                records.append(record)
    assert _transactions(records)
    assert len(lost) == 1
    assert "lost" in lost[0]


def test_a_port_that_comes_back_goes_on_in_the_same_log_beside_a_tap(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    told: list[str] = []
    with ExitStack() as stack:
        other = stack.enter_context(Bench())
        link, descriptor = other.line(tmp_path)
        tap = bench.tap()
        sniffer = stack.enter_context(
            _sniffer(link, tap, log=path, on_remark=told.append, reconnects=True)
        )
        stream = _stream(sniffer)
        speak(descriptor, WRITE)
        speak(descriptor, WRITE)
        assert next(stream).link == link.name
        other.close()
        while not told:
            ask(sniffer, WRITE)
            assert next(stream).link == tap.name
        _, descriptor = bench.line(tmp_path)
        while len(told) < 2:
            ask(sniffer, WRITE)
            assert next(stream).link == tap.name
        speak(descriptor, WRITE)
        speak(descriptor, WRITE)
        assert any(one.link == link.name for one in islice(stream, 2))
    lost, back = told
    assert lost.endswith("lost; is it still plugged in? It is opened again when it is back")
    assert back.startswith(f"{link}: is back after ")
    logged = list(Reading([str(path)], ReadingOptions()).records())
    of_line = [one for one in logged if one.link == link.name]
    kinds = [one.kind.value if isinstance(one, WireEvent) else "transaction" for one in of_line]
    assert kinds == ["transaction", "gap", "gap", "transaction"]


def _stream(sniffer: Sniffer) -> Iterator[NamedTransaction]:
    """The transactions of a sniffer, as they come."""
    records = sniffer.records(until([], lambda _: False))
    return (one for one in records if isinstance(one, NamedTransaction))


def test_the_last_link_that_goes_away_is_an_error_and_the_log_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    def sniff() -> None:
        with Bench() as other:
            link, descriptor = other.line(tmp_path)
            with _sniffer(link, log=path) as sniffer:
                speak(descriptor, WRITE)
                other.close()
                for _ in sniffer.records(until([], lambda _: False)):
                    pass

    with pytest.raises(LinkError, match="lost"):
        sniff()
    with LogReader.open(path) as log:
        list(log.items())
        assert log.closed


class _Log:
    """A log that the disk takes no more for, after so many items."""

    def __init__(self, room: int) -> None:
        self._room = room
        self.ticks = 0
        self.final: Mapping[str, str] | None = None

    def write(self, item: LogItem | DecodingMark) -> None:
        if self._room == 0:
            raise OutputError("a.mcap: the disk is full")
        self._room -= 1

    def tick(self, now_ns: int) -> None:
        self.ticks += 1

    def close(self, final: Mapping[str, str]) -> None:
        self.final = final


def test_a_full_disk_ends_the_run_and_the_log_is_closed(bench: Bench) -> None:
    log = _Log(room=3)
    tap = bench.tap()

    def sniff() -> None:
        with Sniffer([tap], Decoder(Namer()), begin_log=lambda: log) as sniffer:
            ask(sniffer, WRITE, count=3)
            for _ in sniffer.records(until([], lambda _: False)):
                pass

    with pytest.raises(OutputError, match="disk is full"):
        sniff()
    assert log.final is not None


def test_the_log_learns_the_time_while_nothing_comes(bench: Bench) -> None:
    log = _Log(room=100)
    with Sniffer([bench.tap()], Decoder(Namer()), begin_log=lambda: log) as sniffer:
        for _ in sniffer.records(until([], lambda _: log.ticks >= 3)):
            pass
    assert log.ticks >= 3


def test_lost_bytes_and_packets_are_counted_and_told(bench: Bench) -> None:
    log = _Log(room=100)
    told: list[str] = []
    decoder = Decoder(Namer())
    with Sniffer([bench.tap()], decoder, begin_log=lambda: log, on_remark=told.append) as sniffer:
        for missing, packets in ((42, 0), (0, 7), (100, 2), (0, 0)):
            sniffer._inbox.put(
                WireEvent(
                    ts_ns=1,
                    link="x",
                    kind=EventKind.DISCARDED,
                    message=f"{missing} bytes and {packets} packets lost",
                    missing=missing,
                    packets=packets,
                )
            )
        for _ in sniffer.records(lambda _: True):
            pass
    assert log.final == {"discarded_packets": "9", "discarded_bytes": "142"}
    assert told == [
        "x: 42 bytes and 0 packets lost",
        "x: 0 bytes and 7 packets lost",
        "x: 100 bytes and 2 packets lost",
    ]


def test_evidence_that_only_the_decoder_dropped_is_not_counted_as_lost(bench: Bench) -> None:
    """A decoder's bound costs an explanation, no evidence."""
    log = _Log(room=100)
    told: list[str] = []
    given_up = WireEvent(ts_ns=1, link="x", kind=EventKind.DISCARDED, message="", missing=42)
    decoder = Mock(Decoder, feed=lambda _: [given_up], close=lambda: [given_up])
    with Sniffer([bench.tap()], decoder, begin_log=lambda: log, on_remark=told.append) as sniffer:
        sniffer._inbox.put(Quiet(1, "x"))
        for _ in sniffer.records(lambda _: True):
            pass
    assert log.final == {"discarded_packets": "0", "discarded_bytes": "0"}
    assert not told


@pytest.mark.parametrize(("by_ns", "way"), [(3600 * 10**9, "forward"), (-3600 * 10**9, "back")])
def test_a_step_of_the_system_s_clock_is_an_event_and_changes_no_time(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by_ns: int, way: str
) -> None:
    path = tmp_path / "a.mcap"
    records: list[Record] = []
    times: list[int] = []

    def has_step(found: list[Record]) -> bool:
        return any(getattr(one, "kind", None) is EventKind.CLOCK_STEP for one in found)

    enough = until(records, has_step)

    def stop(at_ns: int) -> bool:
        times.append(at_ns)
        return enough(at_ns)

    with _sniffer(bench.tap(), log=path) as sniffer:
        ask(sniffer, WRITE)
        monkeypatch.setattr("mbtool.ports.clock.system_ns", lambda: time.time_ns() + by_ns)
        for record in sniffer.records(stop):
            records.append(record)
    (step,) = (one for one in records if isinstance(one, WireEvent) and not one.link)
    assert step.message.startswith(f"the system's clock was set {way} by 3600.0")
    assert times == sorted(times)
    assert times[-1] - times[0] < 1000 * 10**9
    assert step in list(Reading([str(path)], ReadingOptions()).records())


def test_an_endpoint_cannot_be_listened_to() -> None:
    sniffer = _sniffer(parse_link("tcp:127.0.0.1:1502"))
    with pytest.raises(UsageError, match="put a tap before it"):
        sniffer.__enter__()


@pytest.mark.parametrize(
    "links",
    [
        ("rtu:/dev/ttyUSB0", "ascii:/run/ttyUSB0"),
        ("tap:127.0.0.1:0=10.0.0.9:502", "tap:127.0.0.1:1502=10.0.0.9"),
    ],
)
def test_two_links_of_one_name_are_refused(links: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="two links are called"):
        serial_lines([parse_link(link) for link in links])


def test_serial_links_are_known_by_the_name_their_bytes_carry() -> None:
    serial, tap = parse_link("rtu:/dev/ttyUSB0@9600-8N2"), TapLink(ANY, Endpoint("10.0.0.9", 502))
    assert serial_lines([serial, tap]) == {"ttyUSB0": serial}


def _has_damage(records: list[Record]) -> bool:
    return any(getattr(one, "kind", None) is EventKind.LINE_ERROR for one in records)


def test_damage_that_the_driver_tells_is_shown_and_logged(tmp_path: Path) -> None:
    near, far = os.openpty()
    link = SerialLink(os.ttyname(far), SerialFormat())
    path = tmp_path / "a.mcap"
    records: list[Record] = []
    try:
        with _sniffer(link, log=path) as sniffer:
            stop_marking(link.port)
            os.write(near, b"\xff\x00\xf8")  # What a driver gives for a damaged F8.
            for record in sniffer.records(until(records, _has_damage)):
                records.append(record)
    finally:
        os.close(near)
        os.close(far)
    (damage,) = [
        one for one in records if isinstance(one, WireEvent) and one.kind is EventKind.LINE_ERROR
    ]
    assert damage.message == "parity or framing error at byte F8H"
    assert damage in list(Reading([str(path)], ReadingOptions()).records())

"""A connection between programs of others, recorded by a tap and played back to the same client."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from mbtool.sources.virtual_line import VirtualLine
from tests.end_to_end.peers import (
    RawTcpMaster,
    Wire,
    ask_twenty,
    libmodbus_server,
    pymodbus_server,
    rtu_client,
    tcp_client,
)
from tests.end_to_end.programs import answering, decoded, sniffing, tcp_port

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

POLLS = 3
ASKED = 20 * POLLS

AFTER_TRANSACTION_ID = slice(2, None)
UNIT_AND_PDU_TCP = slice(6, None)
UNIT_AND_PDU_RTU = slice(0, -2)

FAST = SerialFormat(115200, 8, "N", 1)


def test_a_pymodbus_client_gets_the_answers_of_a_pymodbus_server_again(tmp_path: Path) -> None:
    with pymodbus_server() as (port, change):
        log, recorded = record(port, change, tmp_path)
    assert replayed_on_tcp(log) == [one[AFTER_TRANSACTION_ID] for one in recorded.responses]


@pytest.mark.peers
def test_a_pymodbus_client_gets_the_answers_of_a_libmodbus_server_again(tmp_path: Path) -> None:
    with libmodbus_server(tmp_path) as (port, change):
        log, recorded = record(port, change, tmp_path)
    assert replayed_on_tcp(log) == [one[AFTER_TRANSACTION_ID] for one in recorded.responses]


def test_what_a_tap_recorded_is_played_on_a_serial_line(tmp_path: Path) -> None:
    with pymodbus_server() as (port, change):
        log, recorded = record(port, change, tmp_path)
    with VirtualLine(format=FAST) as line:
        options = ("--on", f"rtu:{line.ports[0]}@{FAST}", "--speed", "max")
        with (
            answering("replay", str(log), "--as-slave", *options),
            rtu_client(line.ports[1], FAST.baud) as (client, wire),
        ):
            for _ in range(POLLS):
                ask_twenty(client)
    assert [one[UNIT_AND_PDU_RTU] for one in wire.requests] == (
        [one[UNIT_AND_PDU_TCP] for one in recorded.requests]
    )
    assert [one[UNIT_AND_PDU_RTU] for one in wire.responses] == (
        [one[UNIT_AND_PDU_TCP] for one in recorded.responses]
    )


@pytest.mark.public_captures
@pytest.mark.parametrize(
    ("capture", "where", "count"),
    [
        # A poll of sixteen addresses, over and over: the next answer, not the first, is right.
        ("apache__plc4x/modbus__tcp__manual-test-capture.pcapng", None, 1515),
        # The answers at its end carry other transaction ids than their requests.
        ("ntop__nDPI/modbus.pcap", None, 51),
        # All functions that there are, most refused, some with bodies that are not theirs.
        ("digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap", None, 140),
        # A gateway with four units, up to sixteen open requests and some without an answer.
        ("ITI__ICS-Security-Tools/Modbus__modbus_test.pcap", None, 1137),
        # One of thirteen slaves that all are unit 255.
        ("ITI__ICS-Security-Tools/mb2.pcap", 'link == "141.81.0.66"', 220),
        # File records, masks, FIFO, device identification.
        ("cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap", None, 24),
    ],
)
def test_a_capture_of_others_answers_as_it_did(
    public_captures: Path, capture: str, where: str | None, count: int
) -> None:
    path = public_captures / capture
    options = () if where is None else ("--where", where)
    # Where the capture lacks an answer, the replay may know one from elsewhere.
    records = [one for one in decoded(path, *options) if one["outcome"] != "not-captured"]
    asked = [one for one in records if "request_raw" in one]
    asked.sort(key=lambda one: one["request_ns"])
    assert len(asked) == count
    on = ("--on", "tcp:127.0.0.1:0", "--speed", "max")
    with answering("replay", str(path), "--as-slave", *options, *on) as replay:
        differences = []
        with closing(RawTcpMaster(tcp_port(replay))) as master:
            for one in asked:
                master.send(bytes.fromhex(one["request_raw"]))
                if "response_raw" not in one:
                    continue
                recorded = bytes.fromhex(one["response_raw"])
                answer = master.receive()
                if answer[AFTER_TRANSACTION_ID] != recorded[AFTER_TRANSACTION_ID]:
                    differences.append((one["request_raw"], recorded.hex(), answer.hex()))
            assert master.is_silent()
    assert differences == []


def record(port: int, change: Callable[[], None], folder: Path) -> tuple[Path, Wire]:
    """Poll a server through a tap, changing its data between the polls."""
    log = folder / "connection.mcap"
    with sniffing(f"tap:127.0.0.1:0=127.0.0.1:{port}", "-w", str(log)) as sniffer:
        with tcp_client(tcp_port(sniffer)) as (client, wire):
            for _ in range(POLLS):
                assert sum(answer.isError() for answer in ask_twenty(client)) == 2
                change()
        sniffer.printed.take(ASKED)
        assert sniffer.interrupt() == 130
    assert len({one[AFTER_TRANSACTION_ID] for one in wire.requests}) == 20
    answers = [one[AFTER_TRANSACTION_ID] for one in wire.responses]
    polls = [answers[start : start + 20] for start in range(0, ASKED, 20)]
    assert polls[0] != polls[1] != polls[2]
    logged = decoded(log)
    assert [bytes.fromhex(one["request_raw"]) for one in logged] == wire.requests
    assert [bytes.fromhex(one["response_raw"]) for one in logged] == wire.responses
    return log, wire


def replayed_on_tcp(log: Path) -> list[bytes]:
    """What the same client gets when it asks the log the same; without transaction ids."""
    with (
        answering("replay", str(log), "--as-slave", "--on", "tcp:127.0.0.1:0") as replay,
        tcp_client(tcp_port(replay)) as (client, wire),
    ):
        for _ in range(POLLS):
            ask_twenty(client)
    return [one[AFTER_TRANSACTION_ID] for one in wire.responses]

"""A sniffer that is killed while traffic goes on: what its log still says."""

# The times at which a master had its answers are taken beside the sniffer, so what the log must
# hold does not depend on what the sniffer believes.

from __future__ import annotations

import json
import os
import threading
import time
from contextlib import ExitStack
from itertools import groupby
from typing import TYPE_CHECKING

import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from mbtool.core import Direction, Endpoint, SerialFormat, SerialLink, TcpLink
from mbtool.master.links import MasterLink, open_master
from mbtool.modbus import encode_pdu
from mbtool.sources.virtual_line import VirtualLine
from tests.end_to_end.programs import answering, decoded, sniffing, tcp_port
from tests.sources.live_helpers import MASTER_TIMEOUT_NS, wait_for_end

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

SECOND_NS = 1_000_000_000
FAST = SerialFormat(115200, 8, "N", 1)
UNIT = 1

MOMENTS = [
    # Seconds from one transaction to the next, how many there are, seconds until the kill.
    pytest.param(0.2, 6, 0.0, id="right after a transaction"),
    pytest.param(0.2, 8, 0.1, id="between two transactions"),
    pytest.param(1.0, 3, 0.5, id="one transaction a second"),
    pytest.param(0.2, 1, 1.1, id="after a long silence"),
]


@pytest.mark.parametrize(("pace_s", "count", "rest_s"), MOMENTS)
def test_a_killed_tap_loses_at_most_a_second(
    pace_s: float, count: int, rest_s: float, tmp_path: Path
) -> None:
    log = tmp_path / "killed.mcap"
    with ExitStack() as stack:
        slave = stack.enter_context(answering("slave", "fa3-at1m8x", "--on", "tcp:127.0.0.1:0"))
        tap = f"tap:127.0.0.1:0=127.0.0.1:{tcp_port(slave)}"
        sniffer = stack.enter_context(sniffing(tap, "-w", str(log), "--device", "all=fa3-at1m8x"))
        master = stack.enter_context(
            open_master(TcpLink(Endpoint("127.0.0.1", tcp_port(sniffer))), MASTER_TIMEOUT_NS)
        )
        answered_ns = write_one_after_another(master, 0x0107, pace_s, count)
        threading.Event().wait(rest_s)
        killed_ns = time.time_ns()
        sniffer.process.kill()
        sniffer.wait()
    assert_nothing_is_missing(log, answered_ns, killed_ns)


@pytest.mark.parametrize(("pace_s", "count", "rest_s"), MOMENTS[:2])
def test_a_killed_serial_sniffer_loses_at_most_a_second_and_leaves_no_process(
    pace_s: float, count: int, rest_s: float, tmp_path: Path
) -> None:
    log = tmp_path / "killed.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(VirtualLine(ends=3, format=FAST))
        links = [SerialLink(port, FAST) for port in line.ports]
        stack.enter_context(answering("slave", "idec-ft1a-touch", "--on", str(links[0])))
        sniffer = stack.enter_context(sniffing(str(links[1]), "-w", str(log)))
        readers = [os.pidfd_open(pid) for pid in children(sniffer.process.pid)]
        assert len(readers) == 1
        master = stack.enter_context(open_master(links[2], MASTER_TIMEOUT_NS))
        answered_ns = write_one_after_another(master, 0, pace_s, count)
        threading.Event().wait(rest_s)
        killed_ns = time.time_ns()
        sniffer.process.kill()
        sniffer.wait()
        for reader in readers:
            wait_for_end(reader)
    assert_nothing_is_missing(log, answered_ns, killed_ns)


def write_one_after_another(
    master: MasterLink, address: int, pace_s: float, count: int
) -> list[int]:
    """Write 0, 1, 2... to one register; the answer is when each had been acknowledged."""
    never = threading.Event()
    answered_ns = []
    for value in range(count):
        if value:
            never.wait(pace_s)
        request = encode_pdu(0x06, Direction.REQUEST, address=address, value=value)
        assert master.ask(UNIT, request) == request
        answered_ns.append(time.time_ns())
    return answered_ns


def assert_nothing_is_missing(log: Path, answered_ns: list[int], killed_ns: int) -> None:
    """The log opens, agrees with its schemas, and has all that was answered a second ago."""
    old = sum(one < killed_ns - SECOND_NS for one in answered_ns)
    assert old, "no transaction is older than a second, so this shows nothing"
    in_stock_reader = []
    with log.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            if schema.encoding == "protobuf":
                continue
            body = json.loads(message.data)
            Draft202012Validator(json.loads(schema.data)).validate(body)
            if channel.topic.endswith("/transactions"):
                in_stock_reader.append(body["request_values"])
    in_stock_reader = without_repetitions(in_stock_reader)
    expected = [[value] for value in range(len(answered_ns))]
    assert in_stock_reader == expected[: len(in_stock_reader)]
    assert len(in_stock_reader) >= old
    for options in ((), ("--raw",)):
        found = without_repetitions(one["request_values"] for one in decoded(log, *options))
        assert found[:old] == expected[:old]


def without_repetitions(values: Iterable[list[int]]) -> list[list[int]]:
    """Each run of equal values once.

    A write equals its response: where a busy machine delays one of the two, the line looks as if
    the master had repeated the request.
    """
    return [each for each, _ in groupby(values)]


def children(pid: int) -> list[int]:
    with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
        return [int(child) for child in file.read().split()]

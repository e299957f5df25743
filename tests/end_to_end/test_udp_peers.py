"""Modbus over UDP with peers of others: pymodbus as client and server, and socat."""

from __future__ import annotations

import json
import os
import socket
from typing import TYPE_CHECKING

import pytest
from pymodbus import FramerType

from mbtool.api.slaves import Slave
from mbtool.modbus import mbap_adu
from tests.end_to_end.peers import SIZE, UNIT, ask_twenty, pymodbus_server, tcp_client, udp_client
from tests.end_to_end.programs import Program, mbtool, required, run_mbtool
from tests.packets.building import ethernet, ipv4, packet, pcap, udp

if TYPE_CHECKING:
    from pathlib import Path

SCHEMES = {"udp": FramerType.SOCKET, "rtu+udp": FramerType.RTU}
MS = 1_000_000


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_slave_answers_pymodbus_as_it_does_over_tcp(scheme: str) -> None:
    told = []
    with (
        Slave("idec-ft1a-touch", f"{scheme}:127.0.0.1:0") as slave,
        udp_client(slave.port, SCHEMES[scheme]) as (client, _),
    ):
        told.append([one.encode() for one in ask_twenty(client)])
    with (
        Slave("idec-ft1a-touch", "tcp:127.0.0.1:0") as slave,
        tcp_client(slave.port) as (client, _),
    ):
        told.append([one.encode() for one in ask_twenty(client)])
    assert told[0] == told[1]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_read_and_write_ask_a_server_of_pymodbus(scheme: str) -> None:
    with pymodbus_server(udp=SCHEMES[scheme]) as (port, _):
        link, unit = f"{scheme}:127.0.0.1:{port}", ("--unit", str(UNIT), "--format", "jsonl")
        run_mbtool("write", link, "holding 20=4660", "--yes", *unit)
        rows = run_mbtool("read", link, f"holding 0..{SIZE - 1}", *unit).splitlines()
    words = [word for row in map(json.loads, rows) for word in row["response_values"]]
    assert words == [4660 if place == 20 else 10 * place for place in range(SIZE)]
    assert {json.loads(row)["transport"] for row in rows} == {scheme.replace("+", "-")}


def test_socat_passes_datagrams_between_a_master_and_a_slave() -> None:
    socat = required("socat", "socat")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with Slave("idec-ft1a-touch", "udp:127.0.0.1:0", image={"HR400001": 4660}) as slave:
        heard = f"UDP4-RECVFROM:{port},bind=127.0.0.1,fork"
        with Program(socat, "-d", "-d", heard, f"UDP4-SENDTO:127.0.0.1:{slave.port}") as relay:
            relay.said.find("receiving on|waiting for data|starting|dispatching|reading")
            row = run_mbtool("read", f"udp:127.0.0.1:{port}", "holding 0", "--format", "jsonl")
    assert json.loads(row)["response_values"] == [4660]


def test_sniff_hears_datagrams_on_an_interface(tmp_path: Path) -> None:
    if not hasattr(os, "geteuid") or os.geteuid():
        pytest.skip("capturing on the loopback needs root")
    log = tmp_path / "udp.mcap"
    with Slave("idec-ft1a-touch", "udp:127.0.0.1:0") as slave:
        options = ("--port", str(slave.port), "-w", str(log), "--count", "20", "--format", "jsonl")
        with mbtool("sniff", "net:lo", *options) as sniffer:
            sniffer.said.find("net:lo")
            with udp_client(slave.port) as (client, wire):
                ask_twenty(client)
            assert sniffer.wait() == 0
            rows = [json.loads(line) for line in sniffer.printed.text.splitlines()]
    rows = [row for row in rows if "function" in row]
    assert [row["transport"] for row in rows] == ["udp"] * 20
    again = map(
        json.loads, run_mbtool("decode", str(log), "--raw", "--format", "jsonl").splitlines()
    )
    asked = [row["request_raw"] for row in again if "function" in row]
    assert len(asked) == len(wire.requests) == 20


def test_a_recording_of_datagrams_replays_as_slave_and_as_master(tmp_path: Path) -> None:
    capture = tmp_path / "udp.pcap"
    packets = []
    for number in range(1, 9):
        request = mbap_adu(number, 1, bytes((3, 0, number, 0, 1)))
        response = mbap_adu(number, 1, bytes((3, 2, 0, 10 * number)))
        hosts = ("10.0.0.1", "10.0.0.2")
        asked = ipv4(udp(50000, 502, request), *hosts, protocol=17, identification=number)
        told = ipv4(udp(502, 50000, response), *hosts[::-1], protocol=17, identification=number)
        packets += [
            packet(ethernet(asked), 50 * number * MS),
            packet(ethernet(told), (50 * number + 3) * MS),
        ]
    capture.write_bytes(pcap(packets))
    options = ("--on", "udp:127.0.0.1:0")
    with mbtool("replay", str(capture), "--as-slave", *options) as slave:
        port = slave.said.find(r"udp:127\.0\.0\.1:(\d+)")[1]
        run_mbtool("replay", str(capture), "--as-master", "--to", f"udp:127.0.0.1:{port}")
        row = run_mbtool("read", f"udp:127.0.0.1:{port}", "holding 3", "--format", "jsonl")
    assert json.loads(row)["response_values"] == [30]


def test_stats_and_inventory_know_datagrams(tmp_path: Path) -> None:
    capture = tmp_path / "udp.pcap"
    request, response = mbap_adu(1, 7, b"\3\0\0\0\1"), mbap_adu(1, 7, b"\3\2\0\7")
    hosts = ("10.0.0.1", "10.0.0.2")
    asked = ipv4(udp(50000, 502, request), *hosts, protocol=17)
    told = ipv4(udp(502, 50000, response), *hosts[::-1], protocol=17)
    capture.write_bytes(pcap([packet(ethernet(asked), MS), packet(ethernet(told), 5 * MS)]))
    stats = json.loads(run_mbtool("stats", str(capture), "--json"))
    assert [(link["link"], link["transport"]) for link in stats["links"]] == [("10.0.0.2", "udp")]
    assert "udp 10.0.0.2" in run_mbtool("stats", str(capture))
    inventory = run_mbtool("inventory", str(capture))
    assert "10.0.0.2" in inventory
    assert "udp" in inventory

"""A recording of six devices, replayed at once by one process, asked by pymodbus."""

from __future__ import annotations

import re
import signal
from typing import TYPE_CHECKING, Any

from mbtool.modbus import mbap_adu
from tests.cli.program import Program
from tests.end_to_end.peers import tcp_client
from tests.workflows.site import HOSTS, exchanges, site_capture

if TYPE_CHECKING:
    from pathlib import Path


def _ask(client: Any, request: bytes) -> None:
    code, address, number = request[0], int.from_bytes(request[1:3]), int.from_bytes(request[3:])
    if code == 6:
        client.write_register(address, number)
    else:
        read = client.read_holding_registers if code == 3 else client.read_input_registers
        read(address, count=number)


def test_pymodbus_gets_from_all_six_what_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "site.pcap"
    path.write_bytes(site_capture())
    on = ("--on", "all=tcp:127.0.0.0/24:0", "--speed", "max", "--print")
    with Program("replay", path, "--as-slave", *on) as program:
        places = {}
        for host in HOSTS:
            line = program.await_said(f"{host}: ")
            found = re.search(r"4 different requests to unit 1 on tcp:([\d.]+):(\d+)$", line)
            assert found is not None, line
            places[host] = found[1], int(found[2])
        assert "6 slaves on 6 links" in program.await_said("Ctrl-C ends")
        for device, (address, port) in enumerate(places.values()):
            with tcp_client(port, address) as (client, wire):
                for request, _ in exchanges(device):
                    _ask(client, request)
            assert [adu[7:] for adu in wire.requests] == [pdu for pdu, _ in exchanges(device)]
            assert wire.responses == [
                mbap_adu(number, 1, response)
                for number, (_, response) in enumerate(exchanges(device), 1)
            ]
        told = program.end(signal.SIGINT)
    assert [address for address, _ in places.values()] == [f"127.0.0.{host[-3:]}" for host in HOSTS]
    title, *rows = told.err.splitlines()
    assert title.split() == ["slave", "asked", "recorded", "image", "profile", "unknown"]
    assert [row.split() for row in rows] == [[host, "8", "8", "0", "0", "0"] for host in HOSTS]
    assert max(map(len, told.err.splitlines())) <= 79
    shown = [line for line in told.lines if "06 write holding 5 := 7" in line]
    assert len(shown) == len(HOSTS)
    assert all(host in line for host, line in zip(HOSTS, shown, strict=True))

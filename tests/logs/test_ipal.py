from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from mbtool.cli.main import run
from tests.adversary.illnesses.files import write_pcap
from tests.adversary.illnesses.networks import Network, Site, Tcp
from tests.adversary.illnesses.wire import MS

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

READ = bytes.fromhex("0001 0000 0006 11  03 0064 0002")  # holding registers 100 and 101
VALUES = bytes.fromhex("0001 0000 0007 11  03 04 0017 1234")
WRITE = bytes.fromhex("0002 0000 0006 11  05 0009 ff00")  # coil 9
REFUSED = bytes.fromhex("0003 0000 0003 11  83 02")


def messages(
    path: Path, exchanges: list[tuple[bytes, bytes]], capsys: pytest.CaptureFixture[str]
) -> list[dict[str, Any]]:
    site = Site(seed=1, beside="alone")
    network = Network(site.random)
    tcp = Tcp(network, (site.master, site.slave))
    tcp.open(0)
    for number, (request, response) in enumerate(exchanges, 1):
        tcp.data(number * 100 * MS, 0, request)
        tcp.data(number * 100 * MS + 5 * MS, 1, response)
    write_pcap(path, [(one.at_ns, one.data) for one in network.packets])
    assert run(["decode", str(path), "--format", "ipal"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_a_read_is_two_messages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    request, response = messages(tmp_path / "x.pcap", [(READ, VALUES)], capsys)
    assert request == {
        "id": 0,
        "timestamp": 1_700_000_000.1,
        "protocol": "modbus",
        "malicious": None,
        "src": "10.0.0.1:49201",
        "dest": "10.0.0.9:502:17",
        "length": 12,
        "crc": True,
        "type": 3,
        "activity": "interrogate",
        "responds to": [],
        "data": {"holding.register.100": None, "holding.register.101": None},
    }
    assert (response["src"], response["dest"]) == (request["dest"], request["src"])
    assert (response["activity"], response["responds to"]) == ("inform", [0])
    assert response["data"] == {"holding.register.100": 0x17, "holding.register.101": 0x1234}


def test_a_write_is_a_command_and_an_action(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    request, response = messages(tmp_path / "x.pcap", [(WRITE, WRITE)], capsys)
    assert (request["activity"], response["activity"]) == ("command", "action")
    assert request["data"] == response["data"] == {"coil.9": 1}


def test_an_exception_has_no_values(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    third = READ[:1] + b"\x03" + READ[2:]
    _, response = messages(tmp_path / "x.pcap", [(third, REFUSED)], capsys)
    assert (response["type"], response["data"]) == (3, {})

"""Findings about attacks list the packets of all their cases, so that labels can score them."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from tests.adversary.illnesses.files import write_pcap
from tests.adversary.illnesses.networks import REFUSED, Host, Network, Poll, Site, Tcp
from tests.adversary.illnesses.wire import MS, SECOND
from tests.adversary.labels import score

if TYPE_CHECKING:
    from pathlib import Path

SCANNER = 77
REGISTERS = 80


def test_all_requests_of_a_scan_are_told_and_no_other(tmp_path: Path) -> None:
    site = Site(seed=4, beside="alone")
    site.poll_all(seconds=60)
    scan(site.network, site)
    packets = sorted(site.network.packets, key=lambda one: one.at_ns)
    write_pcap(tmp_path / "scan.pcap", [(one.at_ns, one.data) for one in packets])
    rows = [
        f"{number};{int(bytes([10, 0, 0, SCANNER]) in one.data[26:34])}"
        for number, one in enumerate(packets, 1)
    ]
    (tmp_path / "scan_labeled.csv").write_text("\n".join(rows))
    told = score(tmp_path / "scan.pcap", tmp_path / "scan_labeled.csv")
    assert told.attacks == REGISTERS
    assert (told.precision, told.recall) == (1.0, 1.0)


def scan(network: Network, site: Site) -> None:
    """Ask for many registers that the slave refuses."""
    tcp = Tcp(network, (Host(SCANNER), site.slave))
    tcp.open(20 * SECOND)
    for register in range(REGISTERS):
        at_ns = 21 * SECOND + register * 50 * MS
        poll = Poll(site.units[0], 3000 + register, 1, 4)
        number = tcp.next_id()
        tcp.data(at_ns, 0, poll.request(number))
        refusal = Poll(poll.unit, REFUSED, 1, 4).response(number, Random(1))
        tcp.data(at_ns + 4 * MS, 1, refusal)

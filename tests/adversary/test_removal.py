"""A capture without one of its packets says less, and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.adversary.network import MASTERS, simulate
from tests.adversary.removal import packets_of, remove_one_at_a_time

if TYPE_CHECKING:
    from pathlib import Path

SAMPLE = 25

PARTED = {"ntop__nDPI/modbus.pcap": 3}
"""The last four responses of this capture have other ids than their requests. If one of these
packets is lost, nothing behind it proves that the other three pairs are right."""
PUBLIC = (
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap",
    "camp0__aiengine/pcapfiles__modbus_five_flows.pcap",
    "ntop__nDPI/modbus.pcap",
    "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap",
    "derived/reseg5_suricata.pcap",
)


@pytest.mark.parametrize("master", MASTERS)
def test_one_packet_less_leaves_all_other_transactions_of_a_plant(master: str) -> None:
    packets = simulate(master, (), seed=1, requests=40).packets
    found = remove_one_at_a_time(packets, sample=SAMPLE)
    assert found.counts() == {**dict.fromkeys(found.counts(), 0), "removed": SAMPLE}


@pytest.mark.public_captures
@pytest.mark.parametrize("name", PUBLIC)
def test_one_packet_less_leaves_all_other_transactions_of_a_public_capture(
    name: str, public_captures: Path
) -> None:
    path = public_captures / name
    if not path.exists():
        pytest.skip("this capture is absent")
    found = remove_one_at_a_time(packets_of(path), sample=SAMPLE)
    expected = {**dict.fromkeys(found.counts(), 0), "removed": SAMPLE}
    assert found.counts() == expected | {"parted": PARTED.get(name, 0)}

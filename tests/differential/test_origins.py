"""Each line leads back to its packets: tshark shows the same transaction at their numbers."""

# tshark reads no ADU in a segment that it takes for a retransmission, nor one of which the first
# segment has fewer than 8 bytes. There the payload of the packet must hold the ADU, or begin with
# its end.

from __future__ import annotations

import json
import shutil
import subprocess
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.main import run
from tests.captures import public_folder

if TYPE_CHECKING:
    from pathlib import Path

CAPTURES = (
    "AaronDeRybelHowest__pcap-share/modbus.pcapng",
    "ITI__ICS-Security-Tools/mb2.pcap",
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap",
    "apache__plc4x/modbus__tcp__manual-test-capture.pcapng",
    "arkime__arkime/tests__pcap__modbus.pcap",
    "derived/ipv6_iti_modbus_test.pcap",
    "derived/loop108_plc4x.pcap",
    "derived/multi_if_open.pcapng",
    "derived/reseg5_suricata.pcap",
    "derived/reseg9_nopnop.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap",
    "zeek__zeek/modbusSmall.pcap",
)
FIELDS = (
    "frame.number",
    "mbtcp.trans_id",
    "mbtcp.unit_id",
    "modbus.func_code",
    "eth.src",
    "tcp.payload",
)


class ShownPacket(NamedTuple):
    """What tshark shows of a packet."""

    adus: set[tuple[int, int, int]]
    """Transaction id, unit and function of each ADU that the packet completes."""
    mac: str
    payload: bytes


@pytest.mark.peers
@pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark")
@pytest.mark.parametrize("name", CAPTURES)
def test_each_half_of_a_transaction_is_in_its_packet(name: str, tmp_path: Path) -> None:
    path = public_folder() / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    shown = _shown_by_tshark(path)
    rows = _rows(path, tmp_path)
    assert rows
    for row in rows:
        for half, end in (("request", "source"), ("response", "destination")):
            if f"{half}_raw" in row:
                packet = shown[row[f"{half}_packet"]]
                assert _holds(packet, bytes.fromhex(row[f"{half}_raw"])), (half, row)
                if packet.mac.strip("0:"):  # Absent, or zeros on a loopback interface.
                    assert row[f"{end}_mac"] == packet.mac


def _holds(packet: ShownPacket, raw: bytes) -> bool:
    if packet.adus:
        return (raw[0] << 8 | raw[1], raw[6], raw[7] & 0x7F) in packet.adus
    ends = (raw[-size:] for size in range(1, min(len(raw), len(packet.payload)) + 1))
    return raw in packet.payload or any(map(packet.payload.startswith, ends))


def _rows(path: Path, folder: Path) -> list[dict[str, Any]]:
    out = folder / "rows.jsonl"
    assert run(["decode", str(path), "-o", str(out)]) in (exit_codes.DONE, exit_codes.UNREADABLE)
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert {row["file"] for row in rows} == {str(path)}
    return rows


def _shown_by_tshark(path: Path) -> dict[int, ShownPacket]:
    """What tshark shows of each packet, by its number."""
    wanted = [part for field in FIELDS for part in ("-e", field)]
    command = ["tshark", "-r", str(path), "-Y", "tcp", "-T", "fields", *wanted]
    told = subprocess.run(command, check=True, capture_output=True, text=True)
    shown = {}
    for line in told.stdout.splitlines():
        number, ids, units, functions, mac, payload = line.split("\t")
        each = zip(ids.split(","), units.split(","), functions.split(","), strict=False)
        adus = {(int(a), int(b), int(c) & 0x7F) for a, b, c in each if a and b and c}
        shown[int(number)] = ShownPacket(adus, mac, bytes.fromhex(payload))
    return shown

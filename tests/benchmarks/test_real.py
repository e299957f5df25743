from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.modbus import Outcome
from tests.benchmarks.file_workloads import make_capture, random_requests, scan
from tests.benchmarks.real import captures, enlarge
from tests.captures import read_packets
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import NamedTransaction

REQUEST = bytes.fromhex("0001 0000 0006 11 03 006b 0001")
RESPONSE = bytes.fromhex("0001 0000 0005 11 03 02 0007")


def transactions(path: Path) -> list[NamedTransaction]:
    decoder = Decoder(Namer(), ports=(502,), across=True)
    records = [one for packet in read_packets(path) for one in decoder.feed(packet)]
    return [one for one in records + decoder.close() if not isinstance(one, WireEvent)]


@pytest.mark.parametrize("is_whole", [False, True])
def test_an_enlarged_capture_goes_on_with_each_connection(tmp_path: Path, is_whole: bool) -> None:
    talk = Talk()
    packets = talk.handshake()
    for _ in range(5):
        packets += [talk.request(REQUEST), talk.response(RESPONSE)]
    packets = [*packets, *talk.goodbye()] if is_whole else packets[3:]
    path = tmp_path / "small.pcap"
    path.write_bytes(pcap(packets))
    (tmp_path / "made").mkdir()
    found = transactions(enlarge(path, 4 * len(packets), tmp_path / "made"))
    assert [one.outcome for one in found] == 20 * [Outcome.OK]
    assert sorted(one.start_ns for one in found) == [one.start_ns for one in found]
    same = transactions(enlarge(path, 4 * len(packets), tmp_path / "made", moved=False))
    assert len(same) == (20 if is_whole else 5)


@pytest.mark.parametrize("frames", [random_requests, scan])
def test_made_requests_are_all_answered(tmp_path: Path, frames: object) -> None:
    made = make_capture(tmp_path / "made.pcap", frames, 600)  # type: ignore[arg-type]
    found = transactions(made.path)
    assert len(found) == made.transactions > 250
    assert {one.outcome for one in found} <= {Outcome.OK, Outcome.EXCEPTION}
    assert len({(one.unit, one.address, one.quantity) for one in found}) > 200


def test_only_captures_of_many_packets_are_measured(tmp_path: Path) -> None:
    talk = Talk()
    few = [talk.request(REQUEST) for _ in range(2000)]
    (tmp_path / "few.pcap").write_bytes(pcap(few))
    (tmp_path / "many.pcap").write_bytes(pcap([*few, talk.request(REQUEST)]))
    (tmp_path / "other.pcap").write_bytes(b"no capture")
    assert [name for name, _ in captures(tmp_path)] == ["many.pcap"]
    assert [*captures(tmp_path, ["few"])] == []

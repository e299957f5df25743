"""Where transactions come from: packets and files of serial bytes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace as replace_adu

from mbtool.core import Direction, EventKind, Origin, StreamPlace, WireEvent, parse_line
from mbtool.decode.connections import SerialOrigins
from mbtool.modbus.adu import Adu, DirectionBy, Skipped, Transport
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.packets.building import pcap
from tests.workflows.evidence import captured

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import NamedTransaction

READ = bytes.fromhex("01 03 0000 0002 c40b")
VALUES = bytes.fromhex("01 03 04 1234 5678 8107")
MASTER, SLAVE = bytes.fromhex("000ae4010203"), bytes.fromhex("000417020304")


def decoded(*paths: Path, line: str | None = None) -> list[NamedTransaction]:
    options = ReadingOptions(line=None if line is None else parse_line(line))
    records = Reading([str(path) for path in paths], options).records()
    return [one for one in records if not isinstance(one, WireEvent)]


def test_packets_of_other_protocols_count_too(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    first, *others = captured()
    arp = replace(first, data=b"\xff" * 12 + b"\x08\x06" + bytes(28), original_length=42)
    path.write_bytes(pcap([arp, arp, first, *others]))
    plain = tmp_path / "b.pcap"
    plain.write_bytes(pcap([first, *others]))
    one, other = decoded(path)[0], decoded(plain)[0]
    assert one.request_packet is not None
    assert other.request_packet is not None
    assert one.request_packet == other.request_packet + 2
    assert one.file == str(path)


def test_a_response_in_the_next_file_says_so(tmp_path: Path) -> None:
    paths = [tmp_path / "a.pcap", tmp_path / "b.pcap"]
    packets = captured()
    whole = tmp_path / "whole.pcap"
    whole.write_bytes(pcap(packets))
    one = decoded(whole)[-1]
    assert one.request_packet is not None
    paths[0].write_bytes(pcap(packets[: one.request_packet]))
    paths[1].write_bytes(pcap(packets[one.request_packet :]))
    last = decoded(*paths)[-1]
    assert (last.file, last.response_file) == (str(paths[0]), str(paths[1]))
    assert last.request_packet == one.request_packet
    assert last.request_packet + (last.response_packet or 0) == one.response_packet


@pytest.mark.parametrize("before", [b"", b"\xaa\xbb\xcc", VALUES[:5]])
def test_an_offset_leads_to_the_bytes_of_a_frame(tmp_path: Path, before: bytes) -> None:
    path = tmp_path / "line.bin"
    path.write_bytes(before + (READ + VALUES) * 3)
    data = path.read_bytes()
    transactions = decoded(path, line="rtu@19200-8E1")
    assert len(transactions) >= 2
    for one in transactions:
        for offset, raw in (
            (one.request_offset, one.request_raw),
            (one.response_offset, one.response_raw),
        ):
            if raw is not None:
                assert offset is not None
                assert data[offset : offset + len(raw)] == raw
        assert one.file == str(path)
        assert one.request_packet is None


@given(st.lists(st.integers(1, 9), min_size=1), st.data())
def test_marks_are_dropped_with_their_bytes(sizes: list[int], data: st.DataObject) -> None:
    origins = SerialOrigins()
    origin = Origin("line.bin", 0)
    total = 0
    for size in sizes:
        origins.note(size, StreamPlace(total, None, origin))
        total += size
    given_bytes = data.draw(st.integers(1, total))
    skipped = Skipped(0, EventKind.SKIPPED, "noise", bytes(given_bytes))
    assert origins.added_to([skipped]) == [skipped]
    assert origins.held <= len(sizes)
    assert bool(origins.held) is (given_bytes < total)


FILE, PACKET = Origin("line.bin", 0), Origin("a.pcap", 7)


@pytest.mark.parametrize(
    ("origins", "expected"),
    [
        # In a file of bytes an ADU stands where its first byte does; the first read has 5 bytes.
        ([FILE, FILE, FILE], FILE._replace(offset=1004)),
        ([FILE, None, None], FILE._replace(offset=1004)),
        ([None, FILE, FILE], None),
        # A packet is that of its last byte, which is the first byte of the third read.
        ([PACKET, PACKET._replace(packet=8), PACKET._replace(packet=9)], PACKET._replace(packet=9)),
        ([None, None, PACKET], PACKET),
        ([PACKET, PACKET, None], None),
        ([None, None, None], None),
    ],
)
def test_an_adu_in_three_reads_has_the_origin_of_its_first_or_last_byte(
    origins: list[Origin | None], expected: Origin | None
) -> None:
    reads = SerialOrigins()
    for at, origin in enumerate(origins):
        reads.note(5, origin and StreamPlace(1000 + 5 * at, None, origin))
        reads.note(0, origin and StreamPlace(0, None, origin))
    assert reads.held == 3
    before = Skipped(0, EventKind.SKIPPED, "noise", bytes(4))
    adu = Adu(
        start_ns=0,
        end_ns=0,
        transport=Transport.RTU,
        direction=Direction.REQUEST,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        unit=0,
        pdu=bytes(4),
        raw=bytes(7),
    )
    assert reads.added_to([before, adu]) == [before, replace_adu(adu, origin=expected)]
    assert reads.held == 1

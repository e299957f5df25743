from __future__ import annotations

import io
import struct

import pytest

from mbtool.core import CutError, InputError
from mbtool.packets.capture import read_capture
from mbtool.packets.pcap import MAX_CAPTURED
from tests.packets.building import packet, pcap

_PACKETS = [packet(b"first", 1_500_000_000), packet(b"second", 1_700_000_000_123_456_789)]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("magic", "resolution_ns"), [(0xA1B2C3D4, 1000), (0xA1B23C4D, 1), (0xA1B2CD34, 1000)]
)
def test_reads_both_byte_orders_and_all_resolutions(
    order: str, magic: int, resolution_ns: int
) -> None:
    read = list(read_capture(io.BytesIO(pcap(_PACKETS, order, magic=magic))))

    assert [each.data for each in read] == [b"first", b"second"]
    assert [each.ts_ns for each in read] == [
        each.ts_ns // resolution_ns * resolution_ns for each in _PACKETS
    ]
    assert {(each.link, each.link_type) for each in read} == {("if0", 1)}


def test_a_header_alone_is_an_empty_capture() -> None:
    assert list(read_capture(io.BytesIO(pcap([])))) == []


def test_keeps_the_length_that_a_packet_had_on_the_wire() -> None:
    file = pcap([packet(b"abc", original_length=1500), packet(b"abc", original_length=1)])

    assert [each.original_length for each in read_capture(io.BytesIO(file))] == [1500, 3]


def test_the_link_type_is_the_lower_half_of_its_field() -> None:
    file = bytearray(pcap([packet(b"abc", link_type=276)]))
    file[23] = 0x24  # four bytes of frame check sequence

    assert next(read_capture(io.BytesIO(bytes(file)))).link_type == 276


def test_a_file_that_ends_in_a_record_gives_the_whole_packets_first() -> None:
    packets = read_capture(io.BytesIO(pcap(_PACKETS)[:-1]), "line.pcap")

    assert next(packets).data == b"first"
    with pytest.raises(
        CutError, match=r"^line\.pcap: ends in the middle .* after 1 whole packets$"
    ):
        next(packets)


def test_an_impossible_length_is_damage() -> None:
    record = struct.pack("<IIII", 0, 0, MAX_CAPTURED + 1, MAX_CAPTURED + 1)
    packets = read_capture(io.BytesIO(pcap(_PACKETS) + record), "line.pcap")

    assert len([next(packets), next(packets)]) == 2
    with pytest.raises(InputError, match=r"line\.pcap: damaged after packet 2: .* 262145 bytes"):
        next(packets)


def test_another_version_is_named() -> None:
    file = bytearray(pcap(_PACKETS))
    file[4] = 9

    with pytest.raises(InputError, match=r"version 9\.4 is unknown"):
        list(read_capture(io.BytesIO(bytes(file))))


def test_zeros_in_place_of_a_record_are_the_end() -> None:
    file = pcap(_PACKETS[:1]) + bytes(40)
    packets = read_capture(io.BytesIO(file), "line.pcap")

    assert next(packets).data == b"first"
    with pytest.raises(CutError, match=r"^line\.pcap: zeros after 1 whole packets"):
        next(packets)


def test_an_empty_packet_with_a_time_is_a_packet() -> None:
    file = pcap([packet(b"", 1_000_000_000), *_PACKETS])

    assert [each.data for each in read_capture(io.BytesIO(file))] == [b"", b"first", b"second"]


def test_packets_of_libpcaps_largest_size_are_read() -> None:
    # libpcap: MAXIMUM_SNAPLEN is 262144 bytes.
    (read,) = read_capture(io.BytesIO(pcap([packet(bytes(262144), 1)])))
    assert len(read.data) == 262144


def test_packets_are_counted_from_1_and_know_their_file() -> None:
    read = list(read_capture(io.BytesIO(pcap(_PACKETS)), "line.pcap"))
    assert [(each.file, each.number) for each in read] == [("line.pcap", 1), ("line.pcap", 2)]


@pytest.mark.parametrize(
    "record", [(0, 0, 0, 1), (0, 0, 1, 0), (0, 1, 0, 0), (1, 0, 0, 0), (0, 0, 1, 1)]
)
def test_a_record_with_any_number_in_its_header_is_a_packet(record: tuple[int, ...]) -> None:
    seconds, fraction, captured, original = record
    file = pcap([]) + struct.pack("<IIII", *record) + bytes(captured)
    (read,) = read_capture(io.BytesIO(file))
    assert read.ts_ns == seconds * 1_000_000_000 + fraction * 1000
    assert (len(read.data), read.original_length) == (captured, max(original, captured))


def test_a_file_may_end_in_its_header_or_in_the_header_of_a_record() -> None:
    for end in range(4, 24):
        with pytest.raises(CutError, match=r"^capture: ends inside the file header$"):
            list(read_capture(io.BytesIO(pcap(_PACKETS)[:end])))
    for end in (25, 39, 40, 44):
        with pytest.raises(CutError, match=r"in the middle of a record, after 0 whole packets$"):
            list(read_capture(io.BytesIO(pcap(_PACKETS)[:end])))


def test_other_versions_are_refused_whatever_their_minor_number() -> None:
    for major, minor in ((1, 4), (3, 4), (0, 2)):
        file = bytearray(pcap(_PACKETS))
        file[4:8] = struct.pack("<HH", major, minor)
        with pytest.raises(InputError, match=rf"version {major}\.{minor} is unknown; 2\.4 is read"):
            list(read_capture(io.BytesIO(bytes(file))))
    file = bytearray(pcap(_PACKETS))
    file[6:8] = b"\x03\0"
    assert len(list(read_capture(io.BytesIO(bytes(file))))) == 2

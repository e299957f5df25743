from __future__ import annotations

import io
import struct

import pytest

from mbtool.core import CutError, InputError, Packet
from mbtool.packets.capture import read_capture
from mbtool.packets.pcapng import MAX_BLOCK, MAX_INTERFACES
from tests.packets.building import Pcapng

_NAME, _RESOLUTION, _OFFSET = 2, 9, 14
_MAKE = Pcapng()
_START = _MAKE.section() + _MAKE.interface()


def _read(file: bytes) -> list[Packet]:
    return list(read_capture(io.BytesIO(file), "line.pcapng"))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("resolution", "ticks", "ts_ns"),
    [
        (0, 1_700_000_000, 1_700_000_000_000_000_000),
        (3, 1_700_000_000_123, 1_700_000_000_123_000_000),
        (6, 1_700_000_000_123_456, 1_700_000_000_123_456_000),
        (9, 1_700_000_000_123_456_789, 1_700_000_000_123_456_789),
        (12, 1_700_000_123_456_789, 1_700_000_123_456),
        (0x80 | 1, 3, 1_500_000_000),
        (0x80 | 20, 3 << 19, 1_500_000_000),
        (0x80 | 32, 1_700_000_000 << 32 | 1 << 31, 1_700_000_000_500_000_000),
        (127, 2**64 - 1, 0),
        (0xFF, 2**64 - 1, 0),
    ],
)
def test_reads_every_resolution_in_both_byte_orders(
    order: str, resolution: int, ticks: int, ts_ns: int
) -> None:
    make = Pcapng(order)
    file = (
        make.section()
        + make.interface(276, options={_RESOLUTION: bytes([resolution])})
        + make.enhanced(b"abcde", ticks)
        + make.obsolete(b"fg", ticks)
    )

    read = _read(file)

    assert [(each.data, each.ts_ns, each.link_type) for each in read] == [
        (b"abcde", ts_ns, 276),
        (b"fg", ts_ns, 276),
    ]


def test_times_are_microseconds_unless_the_interface_says_otherwise() -> None:
    assert _read(_START + _MAKE.enhanced(b"a", 5))[0].ts_ns == 5000


@pytest.mark.parametrize(
    ("offset_s", "ts_ns"),
    [(3600, 3600_000_005_000), (-1, 0), (2**63 - 1, 2**63 - 1)],
    ids=["later", "before 1970", "beyond 63 bits"],
)
def test_adds_the_offset_and_stays_within_63_bits(offset_s: int, ts_ns: int) -> None:
    interface = _MAKE.interface(options={_OFFSET: struct.pack("<q", offset_s)})

    assert _read(_MAKE.section() + interface + _MAKE.enhanced(b"a", 5))[0].ts_ns == ts_ns


def test_interfaces_have_their_own_names_and_link_types() -> None:
    file = (
        _MAKE.section()
        + _MAKE.interface(1)
        + _MAKE.interface(113, options={_NAME: b"eth/1\n"})
        + _MAKE.enhanced(b"a", interface=1)
        + _MAKE.enhanced(b"b", interface=0)
    )

    assert [(each.link, each.link_type) for each in _read(file)] == [("eth_1_", 113), ("if0", 1)]


def test_each_section_has_its_own_byte_order_and_interfaces() -> None:
    big = Pcapng(">")
    file = (
        _START
        + _MAKE.interface(113)
        + _MAKE.enhanced(b"a", interface=1)
        + big.section()
        + big.interface(101)
        + big.enhanced(b"b", interface=0)
    )

    assert [(each.data, each.link_type) for each in _read(file)] == [(b"a", 113), (b"b", 101)]
    with pytest.raises(InputError, match="interface 1 is not described"):
        _read(file + big.enhanced(b"c", interface=1))


def test_a_simple_packet_has_the_time_of_the_packet_before_it() -> None:
    file = _START + _MAKE.enhanced(b"a", 5) + _MAKE.simple(b"bcd", 1500)

    assert [(each.data, each.ts_ns) for each in _read(file)] == [(b"a", 5000), (b"bcd\0", 5000)]


def test_a_simple_packet_is_cut_at_the_snapshot_length() -> None:
    file = _MAKE.section() + _MAKE.interface(snaplen=2) + _MAKE.simple(b"bc\0\0", 1500)

    assert [(each.data, each.original_length) for each in _read(file)] == [(b"bc", 1500)]


def test_blocks_without_a_packet_are_skipped() -> None:
    others = b"".join(_MAKE.block(kind, b"whatever") for kind in (4, 5, 10, 0xBAD, 0x40000BAD))

    assert [each.data for each in _read(_START + others + _MAKE.enhanced(b"a"))] == [b"a"]


def test_options_before_an_early_end_are_kept() -> None:
    body = struct.pack("<HHI", 1, 0, 0) + struct.pack("<HH4sHH", _NAME, 4, b"eth0", _RESOLUTION, 99)

    file = _MAKE.section() + _MAKE.block(1, body) + _MAKE.enhanced(b"a")

    assert _read(file)[0].link == "eth0"


@pytest.mark.parametrize(
    ("block", "problem"),
    [
        (struct.pack("<II", 6, MAX_BLOCK + 4), "a block claims 16777220 bytes"),
        (struct.pack("<II", 6, 8), "a block claims 8 bytes"),
        (struct.pack("<II", 6, 33), "a block claims 33 bytes"),
        (struct.pack("<III", 5, 12, 16), "the two lengths of a block differ"),
        (_MAKE.block(6, bytes(16)), "a block is too short for its type"),
        (_MAKE.block(6, struct.pack("<IIIII", 0, 0, 0, 99, 99)), "claims 99 bytes"),
        (struct.pack("<III", 0x0A0D0D0A, 28, 0x11223344), "byte order is 44332211"),
        (_MAKE.block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 2, 0, -1)), "version 2.0"),
    ],
)
def test_damage_is_reported_in_one_line_after_the_packets_before_it(
    block: bytes, problem: str
) -> None:
    packets = read_capture(io.BytesIO(_START + _MAKE.enhanced(b"a") + block), "line.pcapng")

    assert next(packets).data == b"a"
    with pytest.raises(InputError, match=problem) as caught:
        next(packets)
    assert not isinstance(caught.value, CutError)
    assert str(caught.value).startswith("line.pcapng: ")
    assert "\n" not in str(caught.value)


def test_the_number_of_interfaces_is_bounded() -> None:
    many = _MAKE.section() + _MAKE.interface() * MAX_INTERFACES

    assert _read(many + _MAKE.enhanced(b"a", interface=MAX_INTERFACES - 1))[0].data == b"a"
    with pytest.raises(InputError, match="more than 4096 interfaces"):
        _read(many + _MAKE.interface())


def _enhanced(data: bytes, captured: int, original: int, interface: int = 0) -> bytes:
    return _MAKE.block(6, struct.pack("<IIIII", interface, 0, 0, captured, original) + data)


def test_a_packet_has_no_more_bytes_than_its_block() -> None:
    # The block is padded to four bytes of data.
    for captured in range(5):
        (read,) = _read(_START + _enhanced(b"abc", captured, 9))
        assert (read.data, read.original_length) == (b"abc\0"[:captured], 9)
    with pytest.raises(InputError, match="the next packet claims 5 bytes"):
        _read(_START + _enhanced(b"abc", 5, 9))


def test_a_packet_is_no_longer_on_the_wire_than_its_bytes() -> None:
    lengths = [_read(_START + _enhanced(b"abcd", 4, each))[0].original_length for each in (3, 4, 5)]
    assert lengths == [4, 4, 5]


def test_packets_of_libpcaps_largest_size_are_read() -> None:
    most = 262144
    assert len(_read(_START + _enhanced(bytes(most), most, most))[0].data) == most
    with pytest.raises(InputError, match="the next packet claims 262145 bytes"):
        _read(_START + _enhanced(bytes(most + 1), most + 1, most + 1))
    # A simple packet does not say how much of it was captured.
    simple = _START + _MAKE.simple(bytes(most + 4), most + 4)
    assert [(len(one.data), one.original_length) for one in _read(simple)] == [(most, most + 4)]


def test_a_simple_packet_needs_an_interface() -> None:
    with pytest.raises(InputError, match="interface 0 is not described"):
        _read(_MAKE.section() + _MAKE.simple(b"abc"))
    assert _read(_START + _MAKE.simple(b"abc"))[0].ts_ns == 0


def test_a_block_has_12_bytes_at_least_and_16_mebibytes_at_most() -> None:
    longest = _MAKE.block(0xBAD, bytes(16 * 1024 * 1024 - 12))
    shortest = _MAKE.block(0xBAD, b"")
    assert len(_read(_START + longest + shortest + _MAKE.enhanced(b"a"))) == 1
    # A section's first 12 bytes are read before its length is known to be true.
    for length, problem in ((12, "a block claims 12 bytes"), (16, "too short for its type")):
        section = struct.pack("<III", 0x0A0D0D0A, length, 0x1A2B3C4D) + struct.pack("<I", length)
        with pytest.raises(InputError, match=problem):
            _read(section + bytes(99))
    version = struct.pack("<IIIHHI", 0x0A0D0D0A, 20, 0x1A2B3C4D, 1, 0, 20)
    assert _read(version) == []


def test_packets_are_counted_from_1_over_all_kinds_and_sections() -> None:
    file = _START + _MAKE.enhanced(b"a") + _MAKE.simple(b"b") + _START + _MAKE.obsolete(b"c")
    assert [(one.file, one.number) for one in _read(file)] == [
        ("line.pcapng", number) for number in (1, 2, 3)
    ]


def _interface_of(options: bytes) -> bytes:
    return _MAKE.section() + _MAKE.block(1, struct.pack("<HHI", 1, 0, 0) + options)


@pytest.mark.parametrize(
    ("options", "link"),
    [
        (b"\2\0\4\0eth0", "eth0"),  # The list may lack its end.
        (b"\2\0\4\0eth0\2\0\4\0eth1", "eth0"),  # The first one counts.
        (b"\1\0\1\0x\0\0\0\2\0\3\0abc\0", "abc"),
        (b"\1\0\3\0xyz\0\2\0\3\0abc\0", "abc"),
        (b"\1\0\0\0\2\0\3\0abc\0", "abc"),
        (b"\0\0\0\0\2\0\4\0eth0", "if0"),  # Behind the end.
        (b"\2\0\0\0", "if0"),
        (b"\2\0\5\0eth0", "eth0"),
        (b"\2\0\x08\0eth0\0\0\0\0", "eth0"),
        (b"\2\0\4\0e\xffh0", "e\ufffdh0"),
        (b"\2\0\4\0/\n\t\x7f", "____"),
        (b"\2\0\x41\0" + b"x" * 65 + b"\0\0\0", "x" * 64),
        (b"\2\0\x40\0" + b"x" * 63 + b"y", "x" * 63 + "y"),
    ],
)
def test_the_name_of_an_interface_is_found_among_its_options(options: bytes, link: str) -> None:
    assert _read(_interface_of(options) + _MAKE.enhanced(b"a"))[0].link == link


def test_options_of_a_wrong_size_change_no_time() -> None:
    for code, value in ((_OFFSET, bytes(7) + b"\1"), (_OFFSET, b"\1" * 9), (_OFFSET, b"\1" * 7)):
        interface = _MAKE.interface(options={code: value})
        ts_ns = _read(_MAKE.section() + interface + _MAKE.enhanced(b"a", 5))[0].ts_ns
        assert (ts_ns == 5000) == (len(value) != 8)
    interface = _MAKE.interface(options={_RESOLUTION: b""})
    assert _read(_MAKE.section() + interface + _MAKE.enhanced(b"a", 5))[0].ts_ns == 5000
    # Only the first byte counts.
    interface = _MAKE.interface(options={_RESOLUTION: b"\x09\0"})
    assert _read(_MAKE.section() + interface + _MAKE.enhanced(b"a", 5))[0].ts_ns == 5

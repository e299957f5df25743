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

from __future__ import annotations

import gzip
import io
from typing import TYPE_CHECKING

import pytest

from mbtool.columns import packet_block
from mbtool.columns.packet_block import read_blocks
from mbtool.core import CutError, InputError
from mbtool.packets import read_capture
from mbtool.packets.pcap import SEARCHED
from mbtool.sources.files import open_capture
from tests.columns.both_ways import NAME
from tests.packets.building import Pcapng, Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.core import Packet

MAGICS = (0xA1B2C3D4, 0xA1B23C4D, 0xA1B2CD34)


def packets(count: int = 10) -> list[Packet]:
    talk = Talk()
    return [talk.request(bytes([number % 256]) * (number % 300)) for number in range(count)]


def in_blocks(capture: bytes) -> tuple[list[Packet], str]:
    """The packets of a capture, and the error at its end."""
    found: list[Packet] = []
    try:
        for block in read_blocks(io.BufferedReader(io.BytesIO(capture)), NAME):
            found += [block.packet(index) for index in range(len(block))]
    except InputError as error:
        return found, str(error)
    return found, ""


def one_by_one(capture: bytes) -> tuple[list[Packet], str]:
    found: list[Packet] = []
    try:
        for packet in read_capture(io.BytesIO(capture), NAME):
            found.append(packet)
    except InputError as error:
        return found, str(error)
    return found, ""


def key(found: tuple[list[Packet], str]) -> tuple[list[tuple[Packet, str, int]], str]:
    return [(one, one.file, one.number) for one in found[0]], found[1]


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("magic", MAGICS, ids=hex)
@pytest.mark.parametrize("size", [1, 3, 65_536])
def test_blocks_hold_the_packets_of_a_pcap_file(
    order: str, magic: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packet_block, "BLOCK_PACKETS", size)
    capture = pcap(packets(), order, magic=magic)
    assert key(in_blocks(capture)) == key(one_by_one(capture))


@pytest.mark.parametrize("bytes_", [16, 100, 1000])
def test_a_record_may_go_over_the_end_of_what_was_read(
    bytes_: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packet_block, "BLOCK_BYTES", 2000)
    capture = pcap(packets(200)[:bytes_])
    assert key(in_blocks(capture)) == key(one_by_one(capture))


def test_a_file_that_is_cut_anywhere_gives_the_same_packets_and_error() -> None:
    capture = pcap(packets(3))
    for end in range(4, len(capture)):
        assert key(in_blocks(capture[:end])) == key(one_by_one(capture[:end])), end


@pytest.mark.parametrize("zeros", [16, 40, 100_000])
def test_zeros_in_place_of_a_record_give_the_same_packets_and_error(zeros: int) -> None:
    capture = pcap(packets(3)) + bytes(zeros)
    assert in_blocks(capture)[1].endswith(
        "zeros after 3 whole packets, so the file was not written to its end"
    )
    assert key(in_blocks(capture)) == key(one_by_one(capture))


def test_a_record_of_an_impossible_length_comes_behind_the_packets_before_it() -> None:
    capture = bytearray(pcap(packets(3)))
    capture[24 + 8 : 24 + 12] = bytes.fromhex("00000500")
    assert "the next claims 327680 bytes" in in_blocks(bytes(capture))[1]
    assert key(in_blocks(bytes(capture))) == key(one_by_one(bytes(capture)))


@pytest.mark.parametrize("magic", MAGICS, ids=hex)
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("at", [0, 7, 18, 19])
def test_behind_a_damaged_record_reading_goes_on_at_the_next_one(
    at: int, order: str, magic: int
) -> None:
    sent = packets(20)
    file = bytearray(pcap(sent, order, magic=magic))
    size = 24 if magic == 0xA1B2CD34 else 16
    begin = 24 + sum(size + len(one.data) for one in sent[:at])
    file[begin + 8 : begin + 12] = bytes.fromhex("7fffff7f")
    found, error = in_blocks(bytes(file))
    is_last = at == len(sent) - 1
    assert [one.data for one in found] == [one.data for one in sent[:at] + sent[at + 1 :]]
    passed = f"; {size + len(sent[at].data)} bytes were passed over up to the next record"
    assert error.endswith(f"more than 262144{'' if is_last else passed}")
    assert key((found, error)) == key(one_by_one(bytes(file)))


def test_bytes_put_into_a_pcap_cost_no_packet_behind_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packet_block, "BLOCK_PACKETS", 3)
    sent = packets(20)
    whole, begin = pcap(sent), len(pcap(sent[:5]))
    for size in (12, 15, 16, 17, 1000, 70_000):
        file = whole[:begin] + b"\xff" * size + whole[begin:]
        found, error = in_blocks(file)
        assert [one.data for one in found] == [one.data for one in sent]
        assert f"; {size} bytes were passed over" in error
        assert key((found, error)) == key(one_by_one(file))


def test_a_search_for_the_next_record_is_bounded() -> None:
    sent = packets(20)
    whole, begin = pcap(sent), len(pcap(sent[:5]))
    file = whole[:begin] + b"\xff" * 2 * SEARCHED + whole[begin:]
    found, error = in_blocks(file)
    assert (len(found), error.endswith("more than 262144")) == (5, True)
    assert key((found, error)) == key(one_by_one(file))


def test_interfaces_of_a_pcapng_file_keep_their_names_and_types() -> None:
    blocks = Pcapng()
    capture = blocks.section() + blocks.interface() + blocks.interface(101, options={2: b"eth7"})
    capture += b"".join(
        blocks.enhanced(one.data, number, number % 2) for number, one in enumerate(packets())
    )
    assert {(one.link, one.link_type) for one in in_blocks(capture)[0]} == {
        ("if0", 1),
        ("eth7", 101),
    }
    assert key(in_blocks(capture)) == key(one_by_one(capture))


@pytest.mark.parametrize("slowly", [1, 3, 1024])
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("resolution", [b"\x00", b"\x06", b"\x09", b"\x8a", b"\x12"])
def test_blocks_hold_the_packets_of_a_pcapng_file(
    slowly: int, order: str, resolution: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packet_block, "SINGLY_READ_BLOCKS", slowly)
    monkeypatch.setattr(packet_block, "BLOCK_BYTES", 3000)
    capture = pcapng(Pcapng(order), {9: resolution})
    assert len(in_blocks(capture)[0]) == 168
    assert key(in_blocks(capture)) == key(one_by_one(capture))


def pcapng(blocks: Pcapng, options: dict[int, bytes]) -> bytes:
    """Two sections with packet blocks of all kinds, from two interfaces, and other blocks."""
    data = [one.data for one in packets(40)]
    capture = b""
    for _ in range(2):
        capture += blocks.section() + blocks.interface() + blocks.interface(101, options=options)
        capture += b"".join(blocks.enhanced(one, 1 << 40 | len(one), 1) for one in data)
        capture += blocks.block(5, bytes(12)) + blocks.simple(data[20]) + blocks.simple(data[21])
        capture += blocks.obsolete(data[22], 1 << 33, 1) + blocks.block(0x0BAD, b"abc")
        capture += b"".join(blocks.enhanced(one, len(one), len(one) % 2) for one in data)
        capture += blocks.simple(data[3])
    return capture


def test_a_pcapng_file_that_is_cut_anywhere_gives_the_same_packets_and_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(packet_block, "SINGLY_READ_BLOCKS", 3)
    blocks = Pcapng()
    capture = blocks.section() + blocks.interface()
    capture += b"".join(blocks.enhanced(one.data, 7) for one in packets(5))
    for end in range(4, len(capture)):
        assert key(in_blocks(capture[:end])) == key(one_by_one(capture[:end])), end


@pytest.mark.parametrize("value", [0, 1, 7, 255])
def test_a_damaged_packet_block_gives_the_same_packets_and_error(
    value: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packet_block, "SINGLY_READ_BLOCKS", 2)
    blocks = Pcapng()
    capture = blocks.section() + blocks.interface()
    capture += b"".join(blocks.enhanced(one.data, 7) for one in packets(4))
    last = len(capture) - len(blocks.enhanced(packets(4)[3].data))
    for place in range(28):
        damaged = bytearray(capture)
        damaged[last + place] = value
        assert key(in_blocks(bytes(damaged))) == key(one_by_one(bytes(damaged))), place


def test_a_compressed_file_that_is_cut_gives_the_packets_before_the_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap.gz"
    path.write_bytes(gzip.compress(pcap(packets(3000)))[:-3000])
    with open_capture(path) as capture:
        assert "ends before its end mark" in one_error(capture.packets())
    count = 0

    def counted() -> Iterator[None]:
        nonlocal count
        for block in capture.guarded(read_blocks(capture.stream, capture.name)):
            count += len(block)
            yield

    with open_capture(path) as capture:
        assert "ends before its end mark" in one_error(counted())
    assert count > 0


def one_error(items: Iterator[object]) -> str:
    with pytest.raises(CutError) as caught:
        list(items)
    return str(caught.value)


def test_a_file_of_another_kind_is_refused() -> None:
    with pytest.raises(InputError, match="not a capture"):
        list(read_blocks(io.BufferedReader(io.BytesIO(b"abcdefgh")), NAME))

from __future__ import annotations

import io
from dataclasses import replace
from itertools import accumulate
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import CutError, InputError, Packet
from mbtool.packets.capture import CAPTURE_MAGICS, read_capture
from mbtool.packets.pcapng import MAX_INTERFACES
from tests.captures import read_packets
from tests.packets.building import Pcapng, Talk, erspan, ethernet, ipv6, packet, pcap, vxlan
from tests.packets.reading import run_packets, words_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_MAKE = Pcapng()
_PCAP = pcap([packet(b"one", 1000), packet(b"four", 2000), packet(b"", 3000)])
_PCAPNG = (
    _MAKE.section()
    + _MAKE.interface(options={2: b"eth0"})
    + _MAKE.enhanced(b"one", 1)
    + _MAKE.simple(b"four")
    + _MAKE.obsolete(b"", 3)
)


def _read(file: bytes) -> tuple[list[Packet], InputError | None]:
    """Give the packets that come, and the error that ends them."""
    packets: list[Packet] = []
    try:
        for each in read_capture(io.BytesIO(file)):
            packets.append(each)
    except InputError as error:
        return packets, error
    return packets, None


@pytest.mark.parametrize("file", [_PCAP, _PCAPNG], ids=["pcap", "pcapng"])
def test_every_beginning_of_a_file_gives_the_packets_in_it(file: bytes) -> None:
    whole, error = _read(file)
    assert len(whole) == 3
    assert error is None
    clean = 0
    for end in range(1, len(file)):
        packets, error = _read(file[:end])
        assert packets == whole[: len(packets)]
        assert error is None or isinstance(error, CutError)
        clean += error is None
    # Only cuts between two records are not noticed: behind the header, and behind two packets.
    assert clean == (3 if file is _PCAP else 4)


def test_no_bytes_are_no_capture() -> None:
    with pytest.raises(InputError, match=r"^line: empty; a capture has at least a header$"):
        read_capture(io.BytesIO(b""), "line")


def test_another_kind_of_file_is_named_by_its_first_bytes() -> None:
    with pytest.raises(
        InputError, match=r"not a capture .* 7f 45 4c 46.*; pcap and pcapng are read"
    ):
        read_capture(io.BytesIO(b"\x7fELF and more"))


@given(magic=st.sampled_from((b"", *CAPTURE_MAGICS)), rest=st.binary(max_size=200))
def test_no_bytes_raise_anything_but_input_errors(magic: bytes, rest: bytes) -> None:
    _read(magic + rest)


@given(
    file=st.sampled_from((_PCAP, _PCAPNG)),
    changes=st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=4),
)
def test_no_damage_raises_anything_but_input_errors(
    file: bytes, changes: list[tuple[int, int]]
) -> None:
    damaged = bytearray(file)
    for at, value in changes:
        damaged[at % len(file)] = value
    _read(bytes(damaged))


# Names and numbers of packets are those of the table in the README of the captures.
_PUBLIC = {
    "ITI__ICS-Security-Tools/mb2.pcap": 13472,
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap": 2257,
    "digitalbond__Quickdraw-Snort/modbus_test_data_part1.pcap": 118,
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap": 350,
    "arkime__arkime/tests__pcap__modbus.pcap": 1237,
    "zeek__zeek/fuzz-72.pcap": 36,
    "zeek__zeek/modbus-and-non-modbus-p502.pcap": 86,
    "zeek__zeek/modbus-eit.pcap": 4,
    "zeek__zeek/modbusSmall.pcap": 166,
    "zeek__zeek/testing__btest__Traces__ldap__ldap_invalid_credentials.pcap": 49,
    "cisagov__icsnpp-modbus/testing__traces__modbus_example.pcap": 100,
    "uenouan__otsec/pcap__modbus.pcapng": 8,
    "uenouan__otsec/pcap__ModbusException.pcap": 2,
    "snort3__snort3_demo/tests__inspectors__modbus__modbus_w_pafs.pcap": 6,
    "kb221svs__modbus-anomaly-detection/modbus.pcap": 647,
    "kb221svs__modbus-anomaly-detection/modbus_enp0s3.pcap": 52,
    "kb221svs__modbus-anomaly-detection/live_attacks_captured.pcap": 4,
    "jiaxintong__industry_test/hist_a3243045__modbus_2.pcap": 0,
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap": 864,
    "Stepping0__modbus-dnp3-gateway/pcap__modbus.pcapng": 4549,
    "antoine-lemay__Modbus_dataset/CnC_uploading_exe_modbus_6RTU_with_operate.pcap": 1426,
    "antoine-lemay__Modbus_dataset/send_a_fake_command_modbus_6RTU_with_operate.pcap": 11166,
    "antoine-lemay__Modbus_dataset/channel_4d_12s.pcap": 44977,
    "antoine-lemay__Modbus_dataset/channel_4d_5s.pcap": 107577,
    "camp0__aiengine/pcapfiles__modbus_five_flows.pcap": 114,
    "OISF__suricata-verify/tests__modbus__modbus.pcap": 99,
    "AaronDeRybelHowest__pcap-share/modbus.pcapng": 12790,
    "apache__plc4x/modbus__tcp__manual-test-capture.pcapng": 3030,
    "ntop__nDPI/modbus.pcap": 102,
    "yakuter__go-dpi-packet/modbus.pcap": 8,
    "seladb__PcapPlusPlus/Tests__Packet++Test__PacketExamples__modbusFrames.pcap": 1,
    "sigrokproject__sigrok-dumps/brainchild-io-16do.rtac.pcap": 30,
    "sigrokproject__sigrok-dumps/flowmeter_target_0liter_per_min.user0.pcap": 112,
    "derived/gz_eit.pcap.gz": 4,
    "derived/us_be_zeeksmall.pcap": 166,
}


@pytest.mark.public_captures
@pytest.mark.parametrize(("file", "count"), _PUBLIC.items())
def test_public_captures_have_as_many_packets_as_stated(
    public_captures: Path, file: str, count: int
) -> None:
    assert sum(1 for _ in read_packets(public_captures / file)) == count


@pytest.mark.public_captures
def test_a_public_capture_that_was_cut_off_gives_its_whole_packets(public_captures: Path) -> None:
    origin = "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap"
    whole = list(read_packets(public_captures / origin))
    ends = list(accumulate((16 + len(each.data) for each in whole), initial=24))
    packets: list[Packet] = []

    with pytest.raises(CutError, match=r"cutfile_nopnop\.pcap: ends in the middle"):
        packets.extend(read_packets(public_captures / "derived/cutfile_nopnop.pcap"))

    assert packets == whole[: len(packets)]
    assert ends[len(packets)] < 40001 < ends[len(packets) + 1]


@pytest.mark.public_captures
def test_a_public_capture_of_three_interfaces_has_three_link_types(public_captures: Path) -> None:
    packets = read_packets(public_captures / "derived/multi_if_open.pcapng")

    assert {(each.link, each.link_type) for each in packets} == {
        ("if0", 1),
        ("if1", 276),
        ("if2", 108),
    }


def _said() -> list[Packet]:
    talk = Talk()
    return [*talk.handshake(), talk.request(b"request"), talk.response(b"response")]


def _wrapped(wrap: Callable[[bytes], bytes]) -> list[Packet]:
    said = [replace(each, data=wrap(each.data)) for each in _said()]
    return [replace(each, original_length=len(each.data)) for each in said]


def _patched(at: int, value: bytes) -> bytes:
    """The capture of a conversation, with other bytes at a place."""
    file = pcap(_said())
    return file[:at] + value + file[at + len(value) :]


def _of_interface(number: int, interfaces: list[bytes]) -> bytes:
    blocks = (_MAKE.enhanced(each.data, each.ts_ns // 1000, number) for each in _said())
    return _MAKE.section() + b"".join((*interfaces, *blocks))


_TAGS = bytes.fromhex("88a8 0001  8100 0002  8100 0003")
_IPV6_WITH_ROUTING = ethernet(
    ipv6(bytes([6, 2, 0, 0]) + bytes(20) + _said()[3].data[34:61], following=43), 0x86DD
)


@pytest.mark.parametrize(
    "file",
    [
        pcap(_said(), magic=0xA1B23C4D),
        _patched(16, b"\xff\xff\xff\xff"),
        _patched(16, bytes(4)),
        _patched(24 + 12, b"\xff\xff\xff\xff"),
        pcap([packet(b"", 1000), *_said(), packet(b"", 2000)]),
        pcap(_wrapped(lambda data: data[:12] + _TAGS + data[12:])),
        pcap(_wrapped(erspan)),
        pcap(_wrapped(vxlan)),
        _of_interface(0, [_MAKE.interface(1, 0xFFFFFFFF)]),
        _of_interface(4000, [_MAKE.interface()] * MAX_INTERFACES),
    ],
    ids=[
        *("nanoseconds", "longest snaplen", "no snaplen", "a claim of 4 GiB on the wire"),
        *("packets without bytes", "three VLAN tags", "ERSPAN", "VXLAN"),
        *("longest snaplen of an interface", "many interfaces"),
    ],
)
def test_odd_captures_are_read_as_others(file: bytes) -> None:
    packets, error = _read(file)
    assert error is None
    assert words_of(run_packets(packets)) == [">request", "<response"]


def test_a_routing_header_of_ipv6_is_passed_over() -> None:
    assert words_of(run_packets([packet(_IPV6_WITH_ROUTING)])) == [">request"]


@pytest.mark.parametrize(
    ("file", "says"),
    [
        (_patched(24 + 8, b"\xff\xff\xff\x7f"), "the next claims 2147483647 bytes"),
        (_of_interface(0, []), "interface 0 is not described"),
        (_of_interface(0, [_MAKE.interface()] * (MAX_INTERFACES + 1)), "more than 4096 interfaces"),
    ],
    ids=["length", "no interface", "too many interfaces"],
)
def test_damage_is_one_line_that_says_where(file: bytes, says: str) -> None:
    packets, error = _read(file)
    is_pcap = file.startswith(pcap([])[:4])  # Reading goes on behind the damaged record.
    assert [one.number for one in packets] == [1, 2, 3, 4][: 4 * is_pcap]
    assert error is not None
    assert says in str(error)
    assert "after packet 0" in str(error)
    assert "\n" not in str(error)

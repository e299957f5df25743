from __future__ import annotations

import pytest

from mbtool.packets.link_layer import IP_FINDERS, NOT_IP

_ADDRESSES = "00 11 22 33 44 55  66 77 88 99 aa bb"
_COOKED = "0000 0001 0006 66778899aabb 0000"  # type, device, address length, address, unused
_COOKED_V2 = "0000 00000002 0001 00 06 66778899aabb0000"  # reserved, index, device, type, address
_SNAP = "aaaa03 000000"
_THREE = f"{_ADDRESSES} 000102030405 1000"  # three addresses and the sequence number
_RADIOTAP = "00 00 0900 02000000 10"  # version, pad, length, fields, flags: a checksum follows

_HEADERS = [
    (1, f"{_ADDRESSES} 0800"),
    (1, f"{_ADDRESSES} 86dd"),
    (1, f"{_ADDRESSES} 8100 202a 0800"),
    (1, f"{_ADDRESSES} 88a8 0001 8100 202a 86dd"),
    (1, f"{_ADDRESSES} 9100 0001 8100 0002 8100 0003 0800"),
    (1, f"{_ADDRESSES} 892f 0034 0001 0800"),
    (1, f"{_ADDRESSES} 8100 202a 892f 0034 0001 86dd"),
    (1, f"{_ADDRESSES} 8864 1100 0001 0016 0021"),
    (1, f"{_ADDRESSES} 8100 202a 8864 1100 0001 0016 0057"),
    (1, f"{_ADDRESSES} 8847 00010140"),
    (1, f"{_ADDRESSES} 8848 00010040 00020040 00030140"),
    (113, f"{_COOKED} 0800"),
    (113, f"{_COOKED} 8100 202a 86dd"),
    (276, f"0800 {_COOKED_V2}"),
    (276, f"86dd {_COOKED_V2}"),
    (276, f"8100 {_COOKED_V2} 202a 0800"),
    (276, f"892f {_COOKED_V2} 0034 0001 0800"),
    (276, f"8864 {_COOKED_V2} 1100 0001 0016 0021"),
    (276, f"8847 {_COOKED_V2} 00010140"),
    (0, "02 00 00 00"),
    (0, "00 00 00 02"),
    (0, "1e 00 00 00"),
    (108, "00 00 00 02"),
    (108, "00 00 00 18"),
    *((108, f"00 00 00 {family:02x}") for family in (2, 10, 23, 24, 28, 30)),
    (9, "0021"),
    (9, "0057"),
    (9, "21"),
    (9, "ff03 0021"),
    (9, "ff03 57"),
    (50, "ff03 0021"),
    (104, "0f00 0800"),
    (104, "8f00 86dd"),
    (104, "0f00 8847 00010140"),
    (105, f"0801 2c00 {_THREE} {_SNAP} 0800"),
    (105, f"0802 2c00 {_THREE} {_SNAP} 86dd"),
    (105, f"0803 2c00 {_THREE} 060708090a0b {_SNAP} 0800"),
    (105, f"8801 2c00 {_THREE} 0000 {_SNAP} 0800"),
    (105, f"8881 2c00 {_THREE} 0600 01020304 {_SNAP} 0800"),
    (105, f"8801 2c00 {_THREE} 0000 {_SNAP} 8100 202a 0800"),
    (127, f"0000 0800 00000000 0801 2c00 {_THREE} {_SNAP} 0800"),
    (127, f"{_RADIOTAP} 8801 2c00 {_THREE} 0000 {_SNAP} 0800"),
    (127, f"0000 0900 02000000 20 8801 2c00 {_THREE} 0000 0000 {_SNAP} 0800"),
    (
        127,
        f"0000 1900 030000a0 00000000 00000000 0102030405060708 20"
        f"8801 2c00 {_THREE} 0000 0000 {_SNAP} 0800",
    ),
    (12, ""),
    (14, ""),
    (101, ""),
    (228, ""),
    (229, ""),
]


@pytest.mark.parametrize(("link_type", "header"), _HEADERS)
def test_finds_ip_behind_each_link_layer_and_nowhere_if_the_header_is_cut(
    link_type: int, header: str
) -> None:
    before = bytes.fromhex(header)
    assert IP_FINDERS[link_type](before + b"\x45" + bytes(19)) == len(before)
    for end in range(len(before)):
        found = IP_FINDERS[link_type](before[:end])
        # Type 276 begins with the protocol, so its first two bytes may tell where IP would begin.
        assert found == NOT_IP or (link_type == 276 and found == len(before) > end), end
    # MPLS does not name IP: its first byte must be there.
    is_labelled = header.find(" 8847 ") > 0 or header.find(" 8848 ") > 0 or "8847" in header[:4]
    assert IP_FINDERS[link_type](before) == (NOT_IP if is_labelled else len(before))


@pytest.mark.parametrize("version", range(16))
def test_only_version_4_and_6_behind_labels_are_ip(version: int) -> None:
    before = bytes.fromhex(f"{_ADDRESSES} 8847 00010040 ffffff40")
    found = IP_FINDERS[1](before + bytes([version << 4 | 5]))
    assert found == (len(before) if version in (4, 6) else NOT_IP)


def test_only_the_families_of_ip_are_read() -> None:
    read = {
        (link_type, order, family)
        for link_type in (0, 108)
        for order in ("big", "little")
        for family in range(256)
        if IP_FINDERS[link_type](family.to_bytes(4, order) + b"\x45") == 4
    }
    assert {family for *_, family in read} == {2, 10, 23, 24, 28, 30}
    assert len(read) == 2 * 2 * 6


def test_no_other_link_type_is_read() -> None:
    # tcpdump.org/linktypes.html; 12 and 14 are raw IP on some systems.
    assert sorted(IP_FINDERS) == [
        0, 1, 9, 12, 14, 50, 101, 104, 105, 108, 113, 127, 228, 229, 276,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("link_type", "header"),
    [
        (1, f"{_ADDRESSES} 0806"),  # ARP
        (1, f"{_ADDRESSES} 0026"),  # a length, as 802.3 has it
        (1, f"{_ADDRESSES} 8100 202a 0806"),
        (1, f"{_ADDRESSES} 892f 0034 0001 0806"),
        (1, f"{_ADDRESSES} 8863 1109 0001 0016 0021"),  # PPPoE's discovery
        (1, f"{_ADDRESSES} 8864 1100 0001 0016 c021"),  # PPP's own
        (1, f"{_ADDRESSES} 8847 00010140"),  # what is labelled begins with 0: a pseudowire
        (1, f"{_ADDRESSES} 8847 00010040"),  # no last label
        (113, f"{_COOKED} 0806"),
        (276, f"0806 {_COOKED_V2}"),
        (276, f"8100 {_COOKED_V2} 202a 0806"),
        (0, "07 00 00 00"),
        (108, "00 00 00 07"),
    ],
)
def test_passes_over_other_protocols(link_type: int, header: str) -> None:
    assert IP_FINDERS[link_type](bytes.fromhex(header) + bytes(20)) == NOT_IP


@pytest.mark.parametrize("link_type", sorted(set(IP_FINDERS) - {12, 14, 101, 228, 229}))
def test_a_header_that_is_too_short_is_not_ip(link_type: int) -> None:
    assert IP_FINDERS[link_type](b"\x81\x00") == NOT_IP
    assert IP_FINDERS[link_type](b"") == NOT_IP


@pytest.mark.parametrize(
    "frame",
    [
        f"8000 2c00 {_THREE} {_SNAP} 0800",  # a beacon
        f"4801 2c00 {_THREE} {_SNAP} 0800",  # no data
        f"0841 2c00 {_THREE} {_SNAP} 0800",  # encrypted
        f"8801 2c00 {_THREE} 8000 {_SNAP} 0800",  # several packets in one frame
        f"0801 2c00 {_THREE} 424203 000000 0800",  # LLC without SNAP
        f"0801 2c00 {_THREE} {_SNAP} 0806",  # ARP
    ],
)
def test_wireless_frames_without_a_readable_ip_packet_lead_nowhere(frame: str) -> None:
    data = bytes.fromhex(frame) + b"\x45" + bytes(40)
    assert IP_FINDERS[105](data) == NOT_IP
    assert IP_FINDERS[127](bytes.fromhex("0000 0800 00000000") + data) == NOT_IP


def test_a_radiotap_header_that_gives_a_wrong_length_leads_nowhere() -> None:
    for size in (0, 7, 9, 60, 65535):
        head = bytes(2) + size.to_bytes(2, "little") + bytes(4)
        frame = bytes.fromhex(f"0801 2c00 {_THREE} {_SNAP} 0800")
        assert IP_FINDERS[127](head + frame + b"\x45") == NOT_IP

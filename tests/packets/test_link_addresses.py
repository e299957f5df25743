"""MAC addresses and VLAN in the header of the link layer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import LinkAddresses
from mbtool.packets.link_layer import link_addresses

MASTER, SLAVE = bytes.fromhex("000ae4010203"), bytes.fromhex("000417020304")


@pytest.mark.parametrize(
    ("link_type", "header", "addresses"),
    [
        (1, SLAVE + MASTER + b"\x08\x00", ("00:0a:e4:01:02:03", "00:04:17:02:03:04", None)),
        (
            1,
            SLAVE + MASTER + bytes.fromhex("88a8 0064 8100 6005 0800"),
            ("00:0a:e4:01:02:03", "00:04:17:02:03:04", 5),
        ),
        (
            1,
            SLAVE + MASTER + bytes.fromhex("8100 6000 0800"),  # Only a priority.
            ("00:0a:e4:01:02:03", "00:04:17:02:03:04", None),
        ),
        (1, bytes(12) + b"\x08\x00", (None, None, None)),  # The loopback interface.
        (
            113,
            bytes.fromhex("0000 0001 0006") + MASTER + bytes.fromhex("0000 8100 0007 0800"),
            ("00:0a:e4:01:02:03", None, 7),
        ),
        (
            276,
            bytes.fromhex("8100 0000 00000002 0001 0006") + MASTER + bytes.fromhex("00000009 0800"),
            ("00:0a:e4:01:02:03", None, 9),
        ),
    ],
)  # fmt: skip
def test_addresses_are_read_in_the_header_of_the_link_layer(
    link_type: int, header: bytes, addresses: tuple[str | None, str | None, int | None]
) -> None:
    assert link_addresses(link_type, header) == LinkAddresses(*addresses)


@given(st.sampled_from([0, 1, 12, 101, 113, 276]), st.binary(max_size=40))
def test_no_header_raises(link_type: int, header: bytes) -> None:
    link_addresses(link_type, header)


_COOKED = bytes.fromhex("0000 0001 0006") + MASTER + bytes.fromhex("0000 8100 0007 0800")
_COOKED_V2 = (
    bytes.fromhex("8100 0000 00000002 0001 0006") + MASTER + bytes.fromhex("0000 0009 0800")
)


@pytest.mark.parametrize(
    ("link_type", "header", "least"),
    [
        (1, SLAVE + MASTER + bytes.fromhex("8100 0005 0800"), 14),
        (113, _COOKED, 16),
        (276, _COOKED_V2, 20),
    ],
)
def test_a_cut_header_gives_its_addresses_or_nothing(
    link_type: int, header: bytes, least: int
) -> None:
    whole = link_addresses(link_type, header)
    assert whole is not None
    for end in range(len(header)):
        found = link_addresses(link_type, header[:end])
        assert (found is not None) == (end >= least), end
        if found is not None:
            assert (found.source_mac, found.destination_mac) == (
                whole.source_mac,
                whole.destination_mac,
            )


def test_addresses_of_another_length_than_that_of_ethernet_are_not_read() -> None:
    for length in range(16):
        cooked = _COOKED[:5] + bytes([length]) + _COOKED[6:]
        second = _COOKED_V2[:11] + bytes([length]) + _COOKED_V2[12:]
        assert (link_addresses(113, cooked) is not None) == (length == 6)
        assert (link_addresses(276, second) is not None) == (length == 6)
    assert link_addresses(113, _COOKED[:4] + b"\1\6" + _COOKED[6:]) is None


@pytest.mark.parametrize(
    ("tags", "vlan"),
    [
        ("8100 0001 0800", 1),
        ("8100 0FFF 86dd", 4095),
        ("8100 F000 0800", None),  # only a priority
        ("9100 0003 8100 B005 0800", 5),
        ("88a8 0003 892f 0034 0001 8100 0006 0800", 6),
        ("8100 0007 892f 0034 0001 0800", 7),
        ("892f 0034 0001 0800", None),
        ("0800 4500 0030", None),
    ],
)
def test_the_last_vlan_tag_counts(tags: str, vlan: int | None) -> None:
    found = link_addresses(1, SLAVE + MASTER + bytes.fromhex(tags))
    assert found is not None
    assert found.vlan == vlan


def test_any_byte_of_an_address_makes_it_one() -> None:
    for place in range(6):
        address = bytes(place) + b"\1" + bytes(5 - place)
        found = link_addresses(1, address + bytes(6) + b"\x08\x00")
        assert found is not None
        assert (found.source_mac, found.destination_mac) == (None, address.hex(":"))

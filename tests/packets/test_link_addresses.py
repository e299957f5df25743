"""MAC addresses and VLAN in the header of the link layer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import LinkAddresses
from mbtool.packets.link_addresses import link_addresses

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

"""Addresses, names and texts replaced by others."""

from __future__ import annotations

from ipaddress import ip_address

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import pseudonyms
from mbtool.core.pseudonyms import Pseudonyms

ONE, OTHER = Pseudonyms(b"one"), Pseudonyms(b"other")


def _shared(one: bytes, other: bytes) -> int:
    """The number of bits that two addresses have in common at their front."""
    different = int.from_bytes(one) ^ int.from_bytes(other)
    return 8 * len(one) - different.bit_length()


@given(st.binary(min_size=4, max_size=4), st.binary(min_size=4, max_size=4))
def test_two_addresses_share_as_many_bits_as_before(one: bytes, other: bytes) -> None:
    kept = [each for each in (one, other) if each[0] >= 224 or not any(each)]
    made = [ONE.ip(each) for each in (one, other)]
    if not kept:
        assert _shared(*made) == _shared(one, other)
        assert all(each[0] < 224 for each in made)
    else:
        assert all(ONE.ip(each) == each for each in kept)


def test_two_addresses_of_ipv6_share_as_many_bits_as_before() -> None:
    texts = ("2001:db8::1", "2001:db8::2", "2001:db8:1::1", "fe80::1")
    given_ones = [ip_address(text).packed for text in texts]
    made = [ONE.ip(each) for each in given_ones]
    for at, one in enumerate(made):
        assert one != given_ones[at]
        for other_at, other in enumerate(made):
            assert _shared(one, other) == _shared(given_ones[at], given_ones[other_at])


@pytest.mark.parametrize("address", [b"\xff" * 6, bytes(6)])
def test_a_mac_address_of_nobody_stays(address: bytes) -> None:
    assert ONE.mac(address) == address


def test_a_mac_address_is_locally_administered_and_of_one_host() -> None:
    made = ONE.mac(bytes.fromhex("000ae4010203"))
    assert made[0] & 3 == 2
    assert ONE.mac(bytes.fromhex("01005e000001"))[0] & 1


@given(st.binary(max_size=60))
def test_every_letter_and_digit_of_a_text_is_another(text: bytes) -> None:
    made = ONE.text(text)
    assert len(made) == len(text)
    for before, after in zip(text, made, strict=True):
        is_word = bytes((before,)).isalnum()
        assert (before != after) == is_word
        assert bytes((before,)).isdigit() == bytes((after,)).isdigit()
        assert bytes((before,)).isupper() == bytes((after,)).isupper()


def test_units_are_exchanged_among_those_of_slaves() -> None:
    made = [ONE.unit(unit) for unit in range(256)]
    assert sorted(made[1:248]) == [*range(1, 248)]
    assert [made[0], *made[248:]] == [0, *range(248, 256)]


def test_the_key_decides() -> None:
    again = Pseudonyms(b"one")
    address, mac = bytes.fromhex("0a000001"), bytes.fromhex("000ae4010203")
    assert (again.ip(address), again.mac(mac)) == (ONE.ip(address), ONE.mac(mac))
    assert again.shift_ns == ONE.shift_ns
    assert OTHER.ip(address) != ONE.ip(address)
    assert OTHER.mac(mac) != ONE.mac(mac)
    assert OTHER.shift_ns != ONE.shift_ns
    assert ONE.shift_ns % (86_400 * 10**9) == 0 < ONE.shift_ns


def test_names_are_numbered_by_kind_and_hosts_are_addresses_or_names() -> None:
    names = Pseudonyms(b"")
    assert [names.name("line", one) for one in ("ttyUSB0", "ttyS0", "ttyUSB0")] == [
        "line1", "line2", "line1",
    ]  # fmt: skip
    assert names.host("plc.example") == "host1"
    assert names.host("10.0.0.1") == str(ip_address(names.ip(bytes((10, 0, 0, 1)))))


def test_only_the_last_names_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pseudonyms, "MAX_KEPT", 2)
    names = Pseudonyms(b"")
    made = [names.name("host", one) for one in ("a", "b", "a", "c", "a", "b")]
    assert made == ["host1", "host2", "host1", "host3", "host1", "host4"]

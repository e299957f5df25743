"""Which machines may connect to a listener."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.10", "::1", "::ffff:127.0.0.1"])
def test_this_machine_may_always_connect(host: str) -> None:
    assert host in THIS_MACHINE
    assert host in AllowedPeers.parse(["10.0.0.0/8"])


@pytest.mark.parametrize("host", ["10.0.0.1", "fe80::1", "::ffff:10.0.0.1", "0.0.0.0", "::", ""])
def test_without_networks_no_other_machine_may_connect(host: str) -> None:
    assert host not in THIS_MACHINE


@pytest.mark.parametrize(
    ("networks", "host", "may_connect"),
    [
        (["10.0.0.0/8"], "10.255.0.1", True),
        (["10.0.0.0/8"], "11.0.0.1", False),
        (["10.0.0.0/8"], "::ffff:10.0.0.1", True),
        (["10.0.0.0/8"], "::ffff:11.0.0.1", False),
        (["::ffff:10.0.0.0/104"], "10.0.0.1", True),
        (["::ffff:10.0.0.0/104"], "::ffff:11.0.0.1", False),
        (["10.0.0.0/8"], "a00::1", False),
        (["192.168.1.7"], "192.168.1.7", True),
        (["192.168.1.7"], "192.168.1.8", False),
        (["fd00::/8"], "fd12::1", True),
        (["fd00::/8"], "fe80::1", False),
        (["fe80::/10"], "fe80::1%eth0", True),
        (["fd00::/8", "10.1.0.0/16", "10.2.0.0/255.255.0.0"], "10.2.3.4", True),
        (["fd00::/8", "10.1.0.0/16", "10.2.0.0/16"], "10.3.3.4", False),
        (["0.0.0.0/0"], "203.0.113.1", True),
        (["0.0.0.0/0"], "2001:db8::1", True),
        (["::/0"], "203.0.113.1", True),
        (["0.0.0.0/0"], "no address", False),
    ],
)
def test_a_machine_in_one_of_the_networks_may_connect(
    networks: list[str], host: str, may_connect: bool
) -> None:
    assert (host in AllowedPeers.parse(networks)) is may_connect


@pytest.mark.parametrize("text", ["", "10.0.0.0/33", "10/8", "plc.example", "fd00::/129", "1.2.3"])
def test_a_text_that_is_no_network_is_told_what_to_write(text: str) -> None:
    with pytest.raises(UsageError) as told:
        AllowedPeers.parse(["10.0.0.0/8", text])
    assert str(told.value) == (
        f"--allow {text!r}: write a network, such as 192.168.1.0/24 or fd00::/8, or the address "
        "of one machine; 0.0.0.0/0 lets everybody in"
    )


@pytest.mark.parametrize(
    ("text", "network"), [("10.1.2.3/8", "10.0.0.0/8"), ("fd00::1/64", "fd00::/64")]
)
def test_an_address_with_the_length_of_its_network_is_asked_which_is_meant(
    text: str, network: str
) -> None:
    with pytest.raises(UsageError, match=f"inside {network}; write {network} for the whole"):
        AllowedPeers.parse([text])

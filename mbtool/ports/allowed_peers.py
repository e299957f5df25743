"""Decides which machines may connect to a TCP listener: this one, and those given by --allow.

AllowedPeers also has the limits that the user has set for the connections of these machines.
"""

# This machine may always connect, through its loopback address. Other machines may connect if their
# address is in a network given by --allow. A network of prefix length 0 (0.0.0.0/0 or ::/0) admits
# every machine, over IPv4 and IPv6.
#
# A socket for both IPv4 and IPv6 shows the IPv4 address 10.0.0.1 as ::ffff:10.0.0.1 (RFC 4291,
# 2.5.5.2). Such an address is compared, and shown, as IPv4.

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network
from typing import TYPE_CHECKING, Self

from mbtool.core import UsageError
from mbtool.ports.connection_limits import ConnectionLimits

if TYPE_CHECKING:
    from collections.abc import Iterable

_NO_LIMITS = ConnectionLimits()
_MAPPED_BITS = 96
"""An IPv4-mapped IPv6 address (::ffff:a.b.c.d) has 96 bits before the 32 of the IPv4 address."""


@dataclass(frozen=True, slots=True)
class AllowedPeers:
    """The machines that may connect: this one, and all whose address is in one of `networks`."""

    networks: tuple[IPv4Network | IPv6Network, ...] = ()
    limits: ConnectionLimits = _NO_LIMITS

    @classmethod
    def parse(cls, texts: Iterable[str], limits: ConnectionLimits = _NO_LIMITS) -> Self:
        """Read the values of --allow, each a network or the address of one machine.

        Raises UsageError for a value that is neither, such as 192.168.1.7/24, which is an address
        inside a network. `limits` apply to the connections of all machines together.
        """
        return cls(tuple(_network(text) for text in texts), limits)

    def __contains__(self, host: object) -> bool:
        """True if a machine with this IP address may connect; False if `host` is no IP address."""
        try:
            address = plain_address(str(host))
        except ValueError:
            return False
        return address.is_loopback or any(
            network.prefixlen == 0 or address in network for network in self.networks
        )


THIS_MACHINE = AllowedPeers()
"""Only this machine may connect: the default of every listener."""


def plain_address(host: str) -> IPv4Address | IPv6Address:
    """Read an IP address; turn an IPv4-mapped IPv6 address (::ffff:10.0.0.1) into the IPv4 address.

    Raises ValueError for a text that is no IP address.
    """
    address = ipaddress.ip_address(host)
    return (isinstance(address, IPv6Address) and address.ipv4_mapped) or address


def _network(text: str) -> IPv4Network | IPv6Network:
    try:
        network = ipaddress.ip_network(text, strict=False)
    except ValueError:
        raise UsageError(
            f"--allow {text!r}: write a network, such as 192.168.1.0/24 or fd00::/8, "
            "or the address of one machine; 0.0.0.0/0 lets everybody in"
        ) from None
    address = text.partition("/")[0]
    if ipaddress.ip_address(address) != network.network_address:
        raise UsageError(
            f"--allow {text!r}: is an address inside {network}; write {network} for the whole "
            f"network, or {address} for one machine"
        )
    if isinstance(network, IPv6Network) and network.prefixlen >= _MAPPED_BITS:
        mapped = network.network_address.ipv4_mapped
        return IPv4Network((mapped, network.prefixlen - _MAPPED_BITS)) if mapped else network
    return network

"""Replaces addresses, names and texts by pseudonyms; one key always gives the same ones."""

# A pseudonym is made from the original by a keyed hash (BLAKE2b), so without the key nobody can
# tell which original it stands for, except by trying all keys.
#
#     IP address    prefix-preserving, as in Crypto-PAn (Fan, Xu, Ammar, Moon, 2004): bit n is
#                   flipped or kept as the hash of the bits before it says. Two addresses that
#                   share n bits share n bits afterwards, so networks stay networks. Addresses for
#                   many hosts (224.0.0.0 and above, ff00::/8) and 0.0.0.0 stay. So that no other
#                   address becomes one of these, a bit among the first three stays if only ones
#                   come before it, and of IPv6 the first byte stays.
#     MAC address   hashed as a whole, and marked as locally administered. The broadcast address and
#                   zeros stay, and a multicast address becomes another multicast address.
#     text          each letter becomes another letter, each digit another digit; other characters
#                   stay, so the text has the same length and form.
#     name          its kind and a number, in the order of first use: line1, net2
#     unit          another unit, 1 to 247; 0 and those above 247 stay
#     time          all times are earlier by the same number of days, 1 to 3650, so that hours and
#                   other divisions of the day, by which statistics count, stay the same
#
# Memory: the last MAX_KEPT IP addresses, as many MAC addresses and as many names. A name that was
# forgotten gets a new number.

from __future__ import annotations

import string
from functools import lru_cache
from hashlib import blake2b
from ipaddress import ip_address

from mbtool.core.limits import LAST_UNIT
from mbtool.core.moments import DAY_NS

MAX_KEPT = 1 << 16
_MULTICAST = 224
_CLASS_BITS = 3
"""The bits of an IPv4 address that are all 1 in an address for many hosts."""
_MAX_DAYS = 3650
_CLASSES = tuple(
    each.encode() for each in (string.ascii_uppercase, string.ascii_lowercase, string.digits)
)
_FIXED_MACS = (bytes(6), b"\xff" * 6)
_LOCAL, _GROUP = 0x02, 0x01


class Pseudonyms:
    """Gives the pseudonyms of one key."""

    def __init__(self, key: bytes) -> None:
        """`key` may have any length; the same key gives the same pseudonyms, but for names."""
        self._key = blake2b(key, digest_size=32).digest()
        self._counts: dict[str, int] = {}
        order = sorted(
            range(1, LAST_UNIT + 1), key=lambda unit: self._hash(b"unit", bytes((unit,)))
        )
        self._units = dict(zip(range(1, LAST_UNIT + 1), order, strict=True))
        self.shift_ns = (1 + int.from_bytes(self._hash(b"time", b"")) % _MAX_DAYS) * DAY_NS
        """Every time becomes earlier by this, in ns; a whole number of days."""
        self.ip = lru_cache(maxsize=MAX_KEPT)(self._ip)
        self.mac = lru_cache(maxsize=MAX_KEPT)(self._mac)
        self.name = lru_cache(maxsize=MAX_KEPT)(self._name)

    def _hash(self, kind: bytes, data: bytes) -> bytes:
        return blake2b(data, key=self._key, person=kind, digest_size=16).digest()

    def _ip(self, address: bytes) -> bytes:
        """The pseudonym of an IPv4 or IPv6 address, given as its 4 or 16 bytes."""
        if len(address) == 4:
            if address[0] >= _MULTICAST or not any(address):
                return address
            return self._flipped(address, 0)
        if address[0] == 0xFF or not any(address):
            return address
        return self._flipped(address, 8)

    def _flipped(self, address: bytes, kept: int) -> bytes:
        size = 8 * len(address)
        bits = int.from_bytes(address)
        flips = 0
        for bit in range(kept, size):
            before = bits >> (size - bit)
            flip = self._hash(b"ip", before.to_bytes(16) + bytes((bit, size)))[0] & 1
            if bit < _CLASS_BITS and before == (1 << bit) - 1:
                flip = 0
            flips = flips << 1 | flip
        return (bits ^ flips).to_bytes(len(address))

    def _mac(self, address: bytes) -> bytes:
        """The pseudonym of a MAC address, given as its 6 bytes."""
        if address in _FIXED_MACS:
            return address
        made = self._hash(b"mac", address)[:6]
        return bytes(((made[0] | _LOCAL) & ~_GROUP | address[0] & _GROUP,)) + made[1:]

    def text(self, text: bytes) -> bytes:
        """The pseudonym of a text: other letters and digits in the same places."""
        made = bytearray(text)
        noise = b""
        for at, byte in enumerate(text):
            if at % 16 == 0:
                noise = self._hash(b"text", text + at.to_bytes(4))
            for some in _CLASSES:
                if byte in some:
                    others = some.replace(bytes((byte,)), b"")
                    made[at] = others[noise[at % 16] % len(others)]
        return bytes(made)

    def unit(self, unit: int) -> int:
        """The pseudonym of a unit id."""
        return self._units.get(unit, unit)

    def _name(self, kind: str, name: str) -> str:
        """The pseudonym of a name: `kind` and a number. `kind` says what the name is of."""
        self._counts[kind] = self._counts.get(kind, 0) + 1
        return f"{kind}{self._counts[kind]}"

    def host(self, host: str) -> str:
        """The pseudonym of a host: of an IP address another one, of a name `host` and a number."""
        try:
            return str(ip_address(self.ip(ip_address(host).packed)))
        except ValueError:
            return self.name("host", host)

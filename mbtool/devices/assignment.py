"""Which device stands where: WHO=PROFILE of the command line."""

#     5=idec-ft1a-touch                  unit 5 on any link
#     192.168.3.250=fa3-at1m8x           an address, all its ports and units
#     192.168.3.250:1502=fa3-at1m8x      an address and a port; [::1]:1502 for IPv6
#     192.168.3.250/5=./pump.toml        an address and a unit
#     all=idec-ft1a-touch                whatever nothing else names
#
# Where several fit a transaction the most specific wins: an address before a unit, a unit before a
# port. Addresses are numeric, as a capture has them; names are not looked up.

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.core.numbers import parse_number, parse_unit
from mbtool.devices.loading import load_profile
from mbtool.devices.model import Profile
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.modbus.transaction import Transaction

_MAX_REMEMBERED = 1024

_EXAMPLES = "5, 192.168.3.250, 192.168.3.250:1502, 192.168.3.250/5, [::1]:502 or all"
_OTHERS = f"; WHO is {_EXAMPLES}"
_PORTS = range(0x10000)


@dataclass(frozen=True, slots=True)
class Who:
    """Which transactions are meant. A part that is None fits any."""

    host: str | None = None
    port: int | None = None
    unit: int | None = None

    @classmethod
    def of_slave(cls, destination: str | None, unit: int) -> Who:
        """A slave as a transaction names it; None is the slave of a line."""
        host, port = _split_endpoint(destination) if destination is not None else (None, None)
        return cls(host, int(port) if port is not None and port.isdecimal() else None, unit)

    @property
    def at_any_port(self) -> Who:
        return Who(self.host, None, self.unit)

    @property
    def specificity(self) -> int:
        return 4 * (self.host is not None) + 2 * (self.unit is not None) + (self.port is not None)

    def fits(self, host: str | None, port: int | None, unit: int) -> bool:
        return (
            (self.host is None or self.host == host)
            and (self.port is None or self.port == port)
            and (self.unit is None or self.unit == unit)
        )

    def fits_slave(self, destination: str | None, unit: int) -> bool:
        """The same for a slave as a transaction names it."""
        slave = Who.of_slave(destination, unit)
        return self.fits(slave.host, slave.port, unit)

    def __str__(self) -> str:
        if self.host is None:
            return "all" if self.unit is None else str(self.unit)
        host = self.host
        if self.port is not None:
            host = f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}"
        return host if self.unit is None else f"{host}/{self.unit}"


@dataclass(frozen=True, slots=True)
class Assignment:
    """One WHO=PROFILE."""

    who: Who
    profile: Profile


def parse_assignment(text: str) -> Assignment:
    """Read WHO=PROFILE and load the profile. Raises UsageError."""
    who, equals, profile = text.partition("=")
    if not equals or not who or not profile:
        raise UsageError(
            f"device {text!r}: write WHO=PROFILE, for example 192.168.3.250/5=fa3-at1m8x; "
            f"WHO is {_EXAMPLES}"
        )
    return Assignment(parse_who(who), load_profile(profile))


def parse_who(text: str) -> Who:
    """Read WHO. Raises UsageError."""
    if text == "all":
        return Who()
    if text.isascii() and text.isdigit():
        return Who(unit=parse_unit(text, f"device {text!r}", _OTHERS))
    address, slash, unit = text.partition("/")
    number = parse_unit(unit, f"device {text!r}", _OTHERS) if slash else None
    host, port = _split_endpoint(address)
    try:
        numeric = str(ipaddress.ip_address(host))
    except ValueError:
        raise UsageError(f"device {text!r}: WHO is {_EXAMPLES}") from None
    return Who(
        numeric,
        None if port is None else parse_number(port, "port", _PORTS, f"device {text!r}", _OTHERS),
        number,
    )


class Assignments:
    """The devices that the user named."""

    def __init__(self, assignments: Iterable[Assignment] = ()) -> None:
        """Raises UsageError where one WHO has two profiles."""
        # Most specific first, so that the first that fits is the answer.
        self._assignments = sorted(assignments, key=lambda each: -each.who.specificity)
        self._remembered: dict[tuple[str | None, int, Transport], Profile | None] = {}
        # Made once, since a namer knows a profile by its identity.
        self._in_ascii = {
            each.profile.name: each.profile.in_mode(Transport.ASCII) for each in self._assignments
        }
        seen: dict[Who, Profile] = {}
        for each in self._assignments:
            first = seen.setdefault(each.who, each.profile)
            if first != each.profile:
                raise UsageError(
                    f"device {str(each.who)!r} is given two profiles, "
                    f"{first.name} and {each.profile.name}; name one"
                )
        self._demand_one_profile_for_a_name()

    def _demand_one_profile_for_a_name(self) -> None:
        """A log keeps profiles by name, so two of one name could not be told apart in it."""
        named: dict[str, Profile] = {}
        for each in self._assignments:
            if named.setdefault(each.profile.name, each.profile) != each.profile:
                raise UsageError(
                    f"two profiles are called {each.profile.name}; give one of them another name"
                )

    def __iter__(self) -> Iterator[Assignment]:
        """Each assignment, the most specific first."""
        return iter(self._assignments)

    @property
    def profiles(self) -> list[Profile]:
        """The profiles in use, each once."""
        return list({each.profile.name: each.profile for each in self._assignments}.values())

    def profile_for(self, transaction: Transaction) -> Profile | None:
        """The profile of the slave of a transaction, if the user named one.

        On an ASCII line it is the profile in that mode.
        """
        key = (transaction.destination, transaction.unit, transaction.transport)
        try:
            return self._remembered[key]
        except KeyError:
            pass
        if len(self._remembered) >= _MAX_REMEMBERED:
            self._remembered.clear()
        profile = self._find(transaction.destination, transaction.unit)
        if profile is not None and transaction.transport is Transport.ASCII:
            profile = self._in_ascii[profile.name]
        self._remembered[key] = profile
        return profile

    def profiles_at(self, destination: str) -> list[Profile]:
        """The profiles of all units that an endpoint may have."""
        return [
            each.profile
            for each in self._assignments
            if each.who.fits_slave(destination, each.who.unit or 0)
        ]

    def _find(self, destination: str | None, unit: int) -> Profile | None:
        for each in self._assignments:
            if each.who.fits_slave(destination, unit):
                return each.profile
        return None


def _split_endpoint(text: str) -> tuple[str, str | None]:
    """Host and port of `1.2.3.4`, `1.2.3.4:502`, `::1`, `[::1]` and `[::1]:502`."""
    if text.startswith("["):
        host, closed, rest = text[1:].partition("]")
        if rest.startswith(":"):
            return host, rest[1:]
        return (host, None) if closed and not rest else (text, None)
    if text.count(":") == 1:
        host, _, port = text.partition(":")
        return host, port
    return text, None

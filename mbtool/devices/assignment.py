"""Assigns device profiles to slaves, as WHO=PROFILE on the command line says."""

# Examples of WHO=PROFILE, and the slaves to which they assign the profile:
#
#     5=idec-ft1a-touch                  unit 5 on any link
#     192.168.3.250=fa3-at1m8x           an address, all its ports and units
#     192.168.3.250:1502=fa3-at1m8x      an address and a port; [::1]:1502 for IPv6
#     192.168.3.250/5=./pump.toml        an address and a unit
#     all=idec-ft1a-touch                every slave without another assignment
#
# If several assignments match a transaction, the most specific one applies: an address counts more
# than a unit, a unit more than a port. Addresses are numeric, as in a capture; host names are not
# resolved.

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core.errors import UsageError
from mbtool.core.numbers import parse_number, parse_unit
from mbtool.devices.loading import load_profile
from mbtool.devices.model import Profile
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from mbtool.modbus.transaction import Transaction

_MAX_CACHED = 1024

_EXAMPLES = "5, 192.168.3.250, 192.168.3.250:1502, 192.168.3.250/5, [::1]:502 or all"
_OTHERS = f"; WHO is {_EXAMPLES}"
_PORTS = range(0x10000)


@dataclass(frozen=True, slots=True)
class Who:
    """A pattern that matches slaves by host, port and unit. A field that is None matches every
    slave.
    """

    host: str | None = None
    port: int | None = None
    unit: int | None = None

    @classmethod
    def of_slave(cls, destination: str | None, unit: int) -> Who:
        """Return the pattern that matches only the slave `unit` at `destination`.

        `destination` is HOST:PORT; None on a serial line.
        """
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
        """True if the pattern matches the slave `unit` at `destination`.

        `destination` is HOST:PORT; None on a serial line.
        """
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
    """The profile that a user gives to all slaves that match a pattern (WHO=PROFILE)."""

    who: Who
    profile: Profile


def parse_assignment(text: str) -> Assignment:
    """Read WHO=PROFILE and load the profile.

    PROFILE is the name of a built-in profile or the path of a file. Raises UsageError if the text
    has another form or no profile has that name, InputError if the file cannot be read, and
    ProfileError for a mistake in it.
    """
    who, equals, profile = text.partition("=")
    if not equals or not who or not profile:
        raise UsageError(
            f"device {text!r}: write WHO=PROFILE, for example 192.168.3.250/5=fa3-at1m8x; "
            f"WHO is {_EXAMPLES}"
        )
    return Assignment(parse_who(who), load_profile(profile))


def parse_who(text: str) -> Who:
    """Read a pattern for slaves (WHO), such as `5`, `192.168.3.250/5` or `all`.

    Raises UsageError if the text is no such pattern, or a number in it is out of range.
    """
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
    """The profiles that the user assigned to slaves."""

    def __init__(
        self, assignments: Iterable[Assignment] = (), applied: set[Who] | None = None
    ) -> None:
        """Take the user's assignments.

        When a pattern first matches a slave, the pattern is added to the set `applied`; None stands
        for a new set. Raises UsageError if one pattern has two profiles, or two profiles have one
        name.
        """
        self.applied = set() if applied is None else applied
        """The patterns (WHO) that have matched at least one slave so far."""
        # Put the most specific assignment first: the first one that matches a slave applies.
        self._assignments = sorted(assignments, key=lambda each: -each.who.specificity)
        self._cache: dict[tuple[str | None, int, Transport], Profile | None] = {}
        # Make each profile for ASCII mode only once. Namer, which names transactions, caches what
        # it compiles from a profile by the profile's id(), which a second copy would not share.
        self._in_ascii = {
            each.profile.name: each.profile.with_limits_of(Transport.ASCII)
            for each in self._assignments
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
        """Raise UsageError if two different profiles have one name.

        A log identifies a profile by its name.
        """
        named: dict[str, Profile] = {}
        for each in self._assignments:
            if named.setdefault(each.profile.name, each.profile) != each.profile:
                raise UsageError(
                    f"two profiles are called {each.profile.name}; give one of them another name"
                )

    def __iter__(self) -> Iterator[Assignment]:
        """The assignments, the one with the most specific pattern first."""
        return iter(self._assignments)

    @property
    def remarks(self) -> list[str]:
        """One line for the user about each assignment that has matched no slave so far."""
        return [
            f"--device {one.who}={one.profile.name}: has no effect, as no such slave is there"
            for one in self._assignments
            if one.who not in self.applied
        ]

    @property
    def profiles(self) -> list[Profile]:
        """The assigned profiles, each once."""
        return list({each.profile.name: each.profile for each in self._assignments}.values())

    def profile_for(self, transaction: Transaction) -> Profile | None:
        """The profile of the transaction's slave; None if no profile is assigned to the slave.

        For a transaction in ASCII mode, the profile has the limits of that mode.
        """
        return self.profile_of(transaction.destination, transaction.unit, transaction.transport)

    def profile_of(
        self, destination: str | None, unit: int, transport: Transport
    ) -> Profile | None:
        """The profile of a slave, as `profile_for`. `destination` is its HOST:PORT; None on a
        serial line.
        """
        key = (destination, unit, transport)
        try:
            return self._cache[key]
        except KeyError:
            pass
        if len(self._cache) >= _MAX_CACHED:
            self._cache.clear()
        profile = self._find(destination, unit)
        if profile is not None and transport is Transport.ASCII:
            profile = self._in_ascii[profile.name]
        self._cache[key] = profile
        return profile

    def profiles_at(self, destination: str) -> list[Profile]:
        """The profiles that are assigned to some unit at `destination`, which is HOST:PORT."""
        return [
            each.profile
            for each in self._assignments
            if each.who.fits_slave(destination, each.who.unit or 0)
        ]

    def _find(self, destination: str | None, unit: int) -> Profile | None:
        for each in self._assignments:
            if each.who.fits_slave(destination, unit):
                self.applied.add(each.who)
                return each.profile
        return None


def _split_endpoint(text: str) -> tuple[str, str | None]:
    """Split `1.2.3.4`, `1.2.3.4:502`, `::1`, `[::1]` or `[::1]:502` into host and port.

    The port is None if the text has none.
    """
    if text.startswith("["):
        host, closed, rest = text[1:].partition("]")
        if rest.startswith(":"):
            return host, rest[1:]
        return (host, None) if closed and not rest else (text, None)
    if text.count(":") == 1:
        host, _, port = text.partition(":")
        return host, port
    return text, None

"""Reads from a log the settings that are needed to decode its captured bytes again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from mbtool.core import SerialLink, parse_link
from mbtool.devices import Assignment, Assignments, parse_who, profile_from_json

SPEC = "spec"
PORTS = "ports"
RTU_PORTS = "rtu_ports"
ANY_PORT = "any"
"""Keys of a link's metadata. PORTS and RTU_PORTS have lists of TCP ports as values, separated by
spaces. The text ANY_PORT in the list PORTS means every TCP port."""

ACROSS = "across"
"""A key of the metadata record CAPTURE. It is present if the packets of several interfaces belong
to one network, so that they are decoded together."""


class LinkMetadata(Protocol):
    """The metadata on links and devices of a log, or of a pcapng file that `convert` made."""

    @property
    def capture(self) -> Mapping[str, str]: ...
    @property
    def links(self) -> Mapping[str, Mapping[str, str]]: ...
    @property
    def devices(self) -> Mapping[str, str]: ...
    @property
    def profiles(self) -> Mapping[str, bytes]: ...


def all_assignments(log: LinkMetadata, given: Assignments) -> Assignments:
    """Return which device has which profile: as the user says, otherwise as the log says.

    `given` are the user's assignments. The log's are added for devices that `given` does not name.
    """
    named = {str(assignment.who) for assignment in given}
    of_log = (
        Assignment(parse_who(who), profile_from_json(log.profiles[name], f"profile {name}"))
        for who, name in log.devices.items()
        if who not in named and name in log.profiles
    )
    return Assignments([*given, *of_log], given.applied)


def serial_lines(log: LinkMetadata) -> dict[str, SerialLink]:
    """Return the serial links by name. Raises UsageError if the text of a link cannot be parsed."""
    links = ((name, parse_link(one[SPEC])) for name, one in log.links.items() if SPEC in one)
    return {name: link for name, link in links if isinstance(link, SerialLink)}


def names_any_port(log: LinkMetadata) -> bool:
    """True if the recorder captured packets of all TCP ports, not only of named ones."""
    return any(ANY_PORT in one.get(PORTS, "").split() for one in log.links.values())


def ports_of(log: LinkMetadata, key: str) -> tuple[int, ...]:
    """The TCP ports that any link lists under a metadata key: PORTS or RTU_PORTS. Ascending."""
    texts = (one.get(key, "") for one in log.links.values())
    ports = {port for text in texts for port in text.split()}
    return tuple(sorted(int(port) for port in ports if port.isdecimal() and len(port) <= 5))

"""The words every room shares. Standard library only."""

from mbtool.core.errors import (
    CutError,
    InputError,
    LinkError,
    MbtoolError,
    OutputError,
    ProfileError,
    UsageError,
)
from mbtool.core.events import EventKind, WireEvent
from mbtool.core.evidence import Chunk, Connection, Direction, Endpoint, Packet, Quiet, Stamp
from mbtool.core.link_spec import (
    InterfaceLink,
    LinkSpec,
    SerialLink,
    TapLink,
    TcpLink,
    parse_link,
)
from mbtool.core.serial_format import SerialFormat

__all__ = [
    "Chunk",
    "Connection",
    "CutError",
    "Direction",
    "Endpoint",
    "EventKind",
    "InputError",
    "InterfaceLink",
    "LinkError",
    "LinkSpec",
    "MbtoolError",
    "OutputError",
    "Packet",
    "ProfileError",
    "Quiet",
    "SerialFormat",
    "SerialLink",
    "Stamp",
    "TapLink",
    "TcpLink",
    "UsageError",
    "WireEvent",
    "parse_link",
]

"""Classes and errors that all packages of mbtool use. Imports the standard library only."""

from mbtool.core.errors import (
    CutError,
    DamageError,
    EmptyError,
    InputError,
    LinkError,
    MbtoolError,
    OutputError,
    UsageError,
)
from mbtool.core.events import CONNECTION_JOINED, CONNECTION_OPENED, EventKind, WireEvent
from mbtool.core.evidence import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    LinkAddresses,
    Origin,
    Packet,
    Quiet,
    Stamp,
    StreamPlace,
)
from mbtool.core.line_settings import LineSettings, parse_line
from mbtool.core.link_spec import (
    AutoLink,
    InterfaceLink,
    LinkSpec,
    ListenTls,
    SerialLink,
    TapLink,
    TargetTls,
    TcpLink,
    parse_link,
)
from mbtool.core.serial_format import SerialFormat
from mbtool.core.silence import Silence

__all__ = [
    "CONNECTION_JOINED",
    "CONNECTION_OPENED",
    "AutoLink",
    "Chunk",
    "Connection",
    "CutError",
    "DamageError",
    "Direction",
    "EmptyError",
    "Endpoint",
    "EventKind",
    "InputError",
    "InterfaceLink",
    "LineSettings",
    "LinkAddresses",
    "LinkError",
    "LinkSpec",
    "ListenTls",
    "MbtoolError",
    "Origin",
    "OutputError",
    "Packet",
    "Quiet",
    "SerialFormat",
    "SerialLink",
    "Silence",
    "Stamp",
    "StreamPlace",
    "TapLink",
    "TargetTls",
    "TcpLink",
    "UsageError",
    "WireEvent",
    "parse_line",
    "parse_link",
]

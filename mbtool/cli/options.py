"""Options that several commands share, and what their texts mean."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from mbtool.cli.option_groups import OptionGroup

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import LineSettings, Silence
    from mbtool.devices import Assignments
    from mbtool.query.where import Where
    from mbtool.workflows.shared.reading import ReadingOptions


_TCP_PORTS = range(1, 0x10000)


class Format(StrEnum):
    """How records are printed."""

    TABLE = "table"
    JSONL = "jsonl"
    CSV = "csv"


class EventChoice(StrEnum):
    """Which wire events are printed."""

    NONE = "none"
    TROUBLE = "trouble"
    ALL = "all"


DeviceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--device",
        metavar="WHO=PROFILE",
        help="Name what a slave says by its device's manual. WHO is a unit (5), an address "
        "(192.168.3.250), both (192.168.3.250/5) or all; PROFILE is a built-in name (see mbtool "
        "devices) or the path of a TOML file. Repeatable.",
    ),
]
EventsOption = Annotated[
    EventChoice | None,
    typer.Option(
        "--events",
        help="Which wire events to print: skipped bytes, gaps and the like (trouble), connections "
        "too (all), or none. [default: trouble in a table, else none]",
    ),
]
WhereOption = Annotated[
    str | None,
    typer.Option(
        "--where",
        metavar="EXPR",
        help="Take only transactions for which this holds, for example "
        "'unit == 5 and latency_ms > 10'. The answer to an unknown name lists all names.",
    ),
]
PortOption = Annotated[
    list[str] | None,
    typer.Option(
        "--port",
        metavar="PORT|any",
        help="A TCP port of slaves, or any: find Modbus/TCP and RTU over TCP at all ports by what "
        "is said there. Repeatable. [default: 502]",
    ),
]
RtuPortOption = Annotated[
    list[str] | None,
    typer.Option(
        "--rtu-port",
        metavar="PORT",
        help="A TCP port of slaves that speak RTU over TCP. Repeatable.",
    ),
]
LineOption = Annotated[
    str | None,
    typer.Option(
        "--link",
        metavar="LINE",
        help="The serial line that a file's bytes were heard on: rtu@19200-8E1 or ascii@9600-7E1. "
        "With it a file of another kind is read as the bytes themselves, raw or in hexadecimal.",
    ),
]
T15Option = Annotated[
    str | None,
    typer.Option(
        "--t1-5",
        metavar="SILENCE",
        help="The longest silence inside a frame of a serial line: 16bits, 1.5chars, 1ms, 750us. "
        "[default: what profile, baud rate and format say]",
    ),
]
T35Option = Annotated[
    str | None,
    typer.Option(
        "--t3-5",
        metavar="SILENCE",
        help="The shortest silence between frames of a serial line: 28bits, 5ms. "
        "[default: what profile, baud rate and format say]",
    ),
]
RawOption = Annotated[
    bool,
    typer.Option("--raw", help="Decode a log's evidence afresh, in place of what it says."),
]
RemoteOption = Annotated[
    bool,
    typer.Option(
        "--allow-remote",
        help="Listen also where other machines can connect; without it, on loopback only.",
    ),
]


@dataclass(frozen=True, slots=True)
class SourceOptions(OptionGroup):
    """How captures and logs are read."""

    port: PortOption = None
    rtu_port: RtuPortOption = None
    link: LineOption = None

    def read(self, device: Sequence[str] | None = None, *, raw: bool = False) -> ReadingOptions:
        """With --device and --raw of the same command. Raises UsageError, ProfileError."""
        from mbtool.workflows.shared.reading import ReadingOptions

        ports = tcp_ports(self.port, self.rtu_port)
        return ReadingOptions(
            **ports._asdict(),
            assignments=assignments(device),
            line=file_line(self.link),
            raw=raw,
        )


@dataclass(frozen=True, slots=True)
class TimedSourceOptions(SourceOptions):
    """The same, and the silences of serial lines."""

    t1_5: T15Option = None
    t3_5: T35Option = None

    def read(self, device: Sequence[str] | None = None, *, raw: bool = False) -> ReadingOptions:
        return replace(
            SourceOptions.read(self, device, raw=raw),
            t1_5=silence("--t1-5", self.t1_5),
            t3_5=silence("--t3-5", self.t3_5),
        )


class TcpPorts(NamedTuple):
    """The TCP ports on which Modbus is looked for."""

    ports: list[int]
    """Ports of Modbus/TCP."""
    rtu_ports: list[int]
    """Ports of RTU over TCP."""
    any_port: bool
    """True if both are looked for on all other ports, too."""


def tcp_ports(port: Sequence[str] | None, rtu_port: Sequence[str] | None = None) -> TcpPorts:
    """The ports that --port and --rtu-port name. Raises UsageError."""
    from mbtool.core import UsageError

    texts = port or ()
    ports = [_tcp_port("--port", text, ", or any") for text in texts if text != "any"]
    rtu_ports = [_tcp_port("--rtu-port", text) for text in rtu_port or ()]
    both = sorted({*ports} & {*rtu_ports})
    if both:
        raise UsageError(
            f"port {both[0]} is named by --port, for Modbus/TCP, and by --rtu-port, for RTU over "
            "TCP; name it by the one that is right"
        )
    return TcpPorts(ports, rtu_ports, "any" in texts)


def _tcp_port(option: str, text: str, others: str = "") -> int:
    from mbtool.core.numbers import parse_number

    return parse_number(text, "TCP port", _TCP_PORTS, f"Invalid value for '{option}'", others)


def assignments(devices: Sequence[str] | None) -> Assignments:
    """The profiles that --device names. Raises UsageError, ProfileError."""
    from mbtool.devices import Assignments, parse_assignment

    return Assignments(parse_assignment(one) for one in devices or ())


def condition(where: str | None) -> Where:
    """The filter that --where names. Raises UsageError."""
    if where is None:
        return lambda _: True
    from mbtool.query.where import parse_where

    return parse_where(where)


def file_line(text: str | None) -> LineSettings | None:
    """The line that --link names. Raises UsageError."""
    if text is None:
        return None
    from mbtool.core import parse_line

    return parse_line(text)


def silence(option: str, text: str | None) -> Silence | None:
    """What --t1-5 or --t3-5 says. Raises UsageError."""
    if text is None:
        return None
    from mbtool.core import Silence, UsageError

    try:
        return Silence.parse(text)
    except UsageError as error:
        raise UsageError(f"{option}: {error}") from None

"""Options that several commands share, and how their values are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

import typer

from mbtool.cli.option_groups import OptionGroup
from mbtool.core import LineSettings, Silence, UsageError, parse_line
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.numbers import parse_number
from mbtool.views.table_options import TableColumn, TableOptions, TimeStyle

if TYPE_CHECKING:
    from mbtool.decode.line_timing import LineTiming
    from mbtool.devices import Assignments
    from mbtool.query.where import Where
    from mbtool.workflows.shared.reading import ReadingOptions


_TCP_PORTS = range(1, 0x10000)


class Format(StrEnum):
    """The form in which records are printed."""

    TABLE = "table"
    JSONL = "jsonl"
    CSV = "csv"
    PARQUET = "parquet"
    IPAL = "ipal"

    @property
    def suffix(self) -> str:
        """The suffix of files of this form, such as `.csv`."""
        return ".txt" if self is Format.TABLE else f".{self}"

    @property
    def takes_events(self) -> bool:
        """True if wire events can stand between the transactions."""
        return self in (Format.TABLE, Format.JSONL)


FORMATS = {form.suffix: form for form in Format}
"""The form of each suffix of an output."""


class SortKey(StrEnum):
    """The key by which rows are sorted: latency with the slowest first, others least first."""

    TIME = "time"
    LATENCY = "latency"
    LINK = "link"
    UNIT = "unit"
    FUNCTION = "function"
    ADDRESS = "address"


class EventChoice(StrEnum):
    """The choice of the events that are printed: none, all except opened and closed connections, or
    all.
    """

    NONE = "none"
    TROUBLE = "trouble"
    ALL = "all"


ListFormat = Literal["table", "jsonl"]
"""The format in which a list is printed: a table, or JSON lines."""
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
TypesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--types",
        metavar="REFERENCE:TYPE",
        help="Read registers of slaves without a profile as numbers: hr10:f32cdab, "
        "Flow=40011:i16, 'holding 0..9:u32', hr20:str8. Repeatable.",
    ),
]
GuessedTypesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--types",
        metavar="REFERENCE:TYPE|off",
        help="Read registers of slaves without a profile as numbers: hr10:f32cdab. Registers that "
        "are surely one number are shown as one, marked with ?; off shows the words. Repeatable.",
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
_MOMENT = "2.5 or 1h30m since the first request, or 2026-11-22T09:14:03 (UTC)"
StartOption = Annotated[
    str | None,
    typer.Option("--start", metavar="WHEN", help=f"Take what begins then or later: {_MOMENT}."),
]
EndOption = Annotated[
    str | None,
    typer.Option("--end", metavar="WHEN", help="Take what begins before then, as with --start."),
]
TopicPerPointOption = Annotated[
    bool,
    typer.Option(
        "--topic-per-point",
        help="In a log, write each point that changes to a topic of its own, too, for viewers such "
        "as Foxglove (docs/foxglove.md).",
    ),
]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace the file of --output if there is one.")
]
WaitOption = Annotated[
    str | None,
    typer.Option(
        "--wait",
        metavar="TIME",
        help="With @auto: listen at most so long for the settings. [default: 15min, and 1min if "
        "nothing is heard]",
    ),
]
RawOption = Annotated[
    bool,
    typer.Option("--raw", help="Decode a log's evidence afresh, in place of what it says."),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        metavar="N",
        min=1,
        help="Processes that work on large captures at once; 1 for one core. [default: the cores "
        "there are]",
    ),
]
AllowOption = Annotated[
    list[str] | None,
    typer.Option(
        "--allow",
        metavar="CIDR",
        help="Let machines of a network connect over TCP, for example 192.168.1.0/24 or fd00::/8; "
        "0.0.0.0/0 lets everybody in. Repeatable. [default: this machine only]",
    ),
]

ReadOnlyOption = Annotated[
    bool,
    typer.Option(
        "--read-only",
        help="Let a tap pass on only requests that read. It answers all others itself, with "
        "exception 01, and says so.",
    ),
]


class TcpPorts(NamedTuple):
    """The TCP ports on which mbtool looks for Modbus."""

    ports: list[int]
    """The ports whose connections are read as Modbus/TCP."""
    rtu_ports: list[int]
    """The ports whose connections are read as RTU over TCP."""
    any_port: bool
    """True to look for Modbus/TCP and RTU over TCP on the ports that are in neither list, too."""

    @property
    def expected(self) -> frozenset[int] | None:
        """The ports on which Modbus is expected, if mbtool looks for it on all ports: there fewer
        bytes are enough to find it. None if it looks on the given ports only.
        """
        if not self.any_port:
            return None
        return frozenset((*self.ports, *self.rtu_ports, MODBUS_PORT))


@dataclass(frozen=True, slots=True)
class PortOptions(OptionGroup):
    """The options --port and --rtu-port: the TCP ports of slaves."""

    heading: ClassVar[str] = "Ports and lines"

    port: Annotated[
        list[str] | None,
        typer.Option(
            "--port",
            metavar="PORT|any",
            help="A TCP or UDP port of slaves, or any: find Modbus/TCP and RTU over TCP at all "
            "ports by what is said there. Repeatable. [default: 502]",
        ),
    ] = None
    rtu_port: Annotated[
        list[str] | None,
        typer.Option(
            "--rtu-port",
            metavar="PORT",
            help="A TCP or UDP port of slaves that speak RTU over it. Repeatable.",
        ),
    ] = None

    def tcp_ports(self) -> TcpPorts:
        """Read the TCP ports of --port and --rtu-port.

        Raises UsageError for a text that is no port, and for a port that both options name.
        """
        texts = self.port or ()
        ports = [_tcp_port("--port", text, ", or any") for text in texts if text != "any"]
        rtu_ports = [_tcp_port("--rtu-port", text) for text in self.rtu_port or ()]
        both = sorted({*ports} & {*rtu_ports})
        if both:
            raise UsageError(
                f"port {both[0]} is named by --port, for Modbus/TCP, and by --rtu-port, for RTU "
                "over TCP; name it by the one that is right"
            )
        return TcpPorts(ports, rtu_ports, "any" in texts)


@dataclass(frozen=True, slots=True)
class SourceOptions(PortOptions):
    """The options for reading captures and logs."""

    link: Annotated[
        str | None,
        typer.Option(
            "--link",
            metavar="LINE",
            help="The serial line that a file's bytes were heard on: rtu@19200-8E1 or "
            "ascii@9600-7E1. With it a file of another kind is read as the bytes themselves, raw "
            "or in hexadecimal.",
        ),
    ] = None

    def read(
        self,
        device: Sequence[str] | None = None,
        *,
        raw: bool = False,
        silences: SilenceOptions | None = None,
        types: Sequence[str] | None = None,
    ) -> ReadingOptions:
        """Combine these options with the values of --device, --raw, --types and the silences.

        None stands for an option, or a group of options, that the command does not have. Raises
        UsageError for a text that is not understood, ProfileError for a profile that is not found
        or is wrong.
        """
        from mbtool.workflows.shared.reading import ReadingOptions

        ports = self.tcp_ports()
        devices, line = assignments(device, types), file_line(self.link)
        t1_5, t3_5, timeout = (None, None, None) if silences is None else silences.read()
        return ReadingOptions(
            **ports._asdict(),
            assignments=devices,
            line=line,
            t1_5=t1_5,
            t3_5=t3_5,
            response_timeout=timeout,
            raw=raw,
        )


@dataclass(frozen=True, slots=True)
class SilenceOptions(OptionGroup):
    """The silences of serial lines, in place of those that follow from baud rate and format."""

    heading: ClassVar[str] = "Timing of serial lines"

    t1_5: Annotated[
        str | None,
        typer.Option(
            "--t1-5",
            metavar="SILENCE",
            help="The longest silence inside a frame of a serial line: 16bits, 1.5chars, 1ms, "
            "750us. [default: what profile, baud rate and format say]",
        ),
    ] = None
    t3_5: Annotated[
        str | None,
        typer.Option(
            "--t3-5",
            metavar="SILENCE",
            help="The shortest silence between frames of a serial line: 28bits, 5ms. "
            "[default: what profile, baud rate and format say]",
        ),
    ] = None

    response_timeout: Annotated[
        str | None,
        typer.Option(
            "--response-timeout",
            metavar="SILENCE",
            help="How long the master of a serial line waits before it repeats a request: 200ms. "
            "It tells a repeated write from its response, which is equal. [default: learned from "
            "what is heard]",
        ),
    ] = None

    def read(self) -> tuple[Silence | None, Silence | None, Silence | None]:
        """Read t1.5, t3.5 and the response timeout, in this order; None for those not given.

        Raises UsageError for a text that is no duration.
        """
        return (
            _silence("--t1-5", self.t1_5),
            _silence("--t3-5", self.t3_5),
            _silence("--response-timeout", self.response_timeout),
        )


@dataclass(frozen=True, slots=True)
class CaptureOptions(OptionGroup):
    """The options for reading captures and logs in the words of the devices' manuals."""

    source: SourceOptions
    silences: SilenceOptions
    device: DeviceOption = None
    raw: RawOption = False

    def read(self, types: Sequence[str] | None = None) -> ReadingOptions:
        """Combine these options with the values of --types, as `SourceOptions.read` does."""
        return self.source.read(self.device, raw=self.raw, silences=self.silences, types=types)

    def timing(self, types: Sequence[str] | None = None) -> LineTiming:
        """Return the silences and the devices of links that are heard live."""
        from mbtool.decode.line_timing import LineTiming

        return LineTiming(assignments(self.device, types), *self.silences.read())


@dataclass(frozen=True, slots=True)
class TableOptionGroup(OptionGroup):
    """The options that decide how the table shows transactions."""

    heading: ClassVar[str] = "The table"

    time: Annotated[
        TimeStyle,
        typer.Option(
            "--time",
            help="The time of a row; relative: seconds since the first row, "
            "delta: since the row before.",
        ),
    ] = TimeStyle.UTC
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns",
            metavar="NAMES",
            help=f"Columns before the text, with commas: {','.join(TableColumn)}.",
        ),
    ] = None
    in_hex: Annotated[
        bool, typer.Option("--hex", help="Show values as 1234H, without the names of points.")
    ] = False
    wide: Annotated[
        bool, typer.Option("--wide", help="One line a row, however long, as in a pipe.")
    ] = False
    full: Annotated[
        bool, typer.Option("--full", help="Show all values, on as many lines as they need.")
    ] = False

    def read(self) -> TableOptions:
        """Return the chosen options. Raises UsageError for a name that is no column."""
        names = [] if self.columns is None else [one.strip() for one in self.columns.split(",")]
        wrong = [one for one in names if one not in set(TableColumn)]
        if wrong:
            raise UsageError(
                f"--columns: there is no column {wrong[0]!r}; there are {', '.join(TableColumn)}"
            )
        columns = tuple(map(TableColumn, names))
        return TableOptions(self.time, columns, self.in_hex, self.wide, self.full)


def _tcp_port(option: str, text: str, others: str = "") -> int:
    return parse_number(text, "TCP port", _TCP_PORTS, f"Invalid value for '{option}'", others)


def assignments(devices: Sequence[str] | None, types: Sequence[str] | None = None) -> Assignments:
    """Load the profiles that --device assigns to slaves; all others have the points of --types.

    Raises UsageError for a text that is not WHO=PROFILE, ProfileError for a profile that is not
    found or is wrong.
    """
    from mbtool.devices import Assignment, Assignments, Who, parse_assignment

    assigned = [parse_assignment(one) for one in devices or ()]
    if types and all(one.who != Who() for one in assigned):
        from mbtool.workflows.shared.typed_references import typed_points, with_points

        assigned.append(Assignment(Who(), with_points(None, typed_points(types))))
    return Assignments(assigned)


def given_types(types: Sequence[str] | None) -> tuple[list[str], bool]:
    """Return the types that --types gives, and False if `off` is among its values: no guesses."""
    given = [one for one in types or () if one.strip().lower() != "off"]
    return given, len(given) == len(types or ())


def condition(where: str | None) -> Where:
    """Return the filter of --where as a function; without --where every transaction passes.

    Raises UsageError for an expression that is wrong or can never be true.
    """
    if where is None:
        return lambda _: True
    from mbtool.query.where import parse_where

    return parse_where(where)


def file_line(text: str | None) -> LineSettings | None:
    """Parse the value of --link: the serial line on which the bytes in a file were heard.

    Returns None without --link. Raises UsageError for a text that is no line.
    """
    if text is None:
        return None
    return parse_line(text)


def _silence(option: str, text: str | None) -> Silence | None:
    if text is None:
        return None
    try:
        return Silence.parse(text)
    except UsageError as error:
        raise UsageError(f"{option}: {error}") from None

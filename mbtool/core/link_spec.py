"""Reads the LINK strings of the command line. docs/links.md describes them."""

#     rtu:/dev/ttyUSB0@19200-8E1         serial RTU
#     rtu:/dev/ttyUSB0,/dev/ttyUSB1@...  two taps on one line: the master's side, the slaves' side
#     ascii:/dev/ttyUSB0@9600-7E1        serial ASCII
#     rtutap:/dev/A@19200-8E1=/dev/B     a relay in a line cut in two: master's end, slaves' end
#     rtu:/dev/ttyUSB0@auto              settings and mode that are found by listening
#     net:eth0                           a network interface
#     net:eth0,eth1                      several interfaces of one network; packets of one
#                                        connection may arrive at any of them
#     tap:127.0.0.1:1502=10.0.0.9:502    an in-line TCP relay: where it listens, where it connects
#     tcp:127.0.0.1:1502                 a Modbus/TCP endpoint
#     rtu+tcp:127.0.0.1:1502             an endpoint that speaks RTU over TCP
#     udp:127.0.0.1:1502                 an endpoint that speaks Modbus over UDP
#     rtu+udp:127.0.0.1:1502             an endpoint that speaks RTU over UDP
#
# An IPv6 address stands in brackets: tcp:[::1]:1502.

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import PurePath

from mbtool.core.errors import UsageError
from mbtool.core.evidence import Endpoint
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.serial_format import ModemLines, SerialFormat

AUTO = "auto"
ANY_INTERFACE = "any"
MAX_INTERFACES = 16

HEARD = (
    "rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, rtutap:PORT@19200-8E1=PORT, net:INTERFACE "
    "or tap:LISTEN=TARGET"
)
"""The forms of LINK that the command sniff accepts, as a text for error messages."""
ANSWERED = (
    "rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT, rtu+tcp:HOST:PORT, udp:HOST:PORT or "
    "rtu+udp:HOST:PORT"
)
"""The forms of LINK that the commands slave and replay accept, as a text for error messages."""
_ALL = (
    "rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, rtutap:PORT@19200-8E1=PORT, net:INTERFACE, "
    "tap:LISTEN=TARGET, tcp:HOST:PORT, rtu+tcp:HOST:PORT, udp:HOST:PORT or rtu+udp:HOST:PORT"
)

_ENDPOINT = re.compile(
    r"(?:\[(?P<bracketed>[^\s/@\[\]]+)\]|(?P<host>[^\s/@\[\]:]+))(?::(?P<port>[0-9]{1,5}))?"
)

_OWN_ADDRESSES = {
    "0.0.0.0": ("127.0.0.1", "localhost"),
    "::": ("::1", "127.0.0.1", "localhost"),
    "127.0.0.1": ("localhost",),
    "localhost": ("127.0.0.1",),
}
"""Other addresses and names that also reach a tap that listens at the address in the key. A tap
must not connect to one of them, as it would connect to itself."""


@dataclass(frozen=True, slots=True)
class SerialLink:
    """A serial line that carries RTU or ASCII, and the one or two ports on it."""

    port: str
    """The port on the line; if there are two, the port that receives the master's bytes."""
    format: SerialFormat
    ascii: bool = False
    slave_port: str | None = None
    """The port that receives the slaves' bytes; None if one port receives both sides."""
    is_relay: bool = field(default=False, kw_only=True)
    """True if the line is cut in two, and mbtool passes bytes between its two ports."""
    modem_lines: ModemLines = field(default=ModemLines(), kw_only=True)
    """The states that DTR and RTS get while mbtool listens on the port. The text of the link does
    not contain them."""

    def __post_init__(self) -> None:
        if self.is_relay and self.slave_port is None:
            raise ValueError("a relay joins two ports")

    @property
    def scheme(self) -> str:
        return f"{'ascii' if self.ascii else 'rtu'}{'tap' if self.is_relay else ''}"

    @property
    def ports(self) -> tuple[str, ...]:
        return (self.port,) if self.slave_port is None else (self.port, self.slave_port)

    @property
    def name(self) -> str:
        return "+".join(PurePath(port).name for port in self.ports)

    def demand_one_port(self) -> None:
        """Raise UsageError if the link has two ports, as two ports can listen but not answer."""
        if self.slave_port is not None:
            raise UsageError(
                f"link {self}: two ports can only listen; to answer, name one, "
                f"for example {'ascii' if self.ascii else 'rtu'}:{self.port}@{self.format}"
            )

    def __str__(self) -> str:
        if self.is_relay:
            return f"{self.scheme}:{self.port}@{self.format}={self.slave_port}"
        return f"{self.scheme}:{','.join(self.ports)}@{self.format}"


@dataclass(frozen=True, slots=True)
class AutoLink:
    """A serial line whose settings are still to be found by listening."""

    ports: tuple[str, ...]
    """The line's only port, or two ports: the one at the master's side, then the slaves' side."""
    only_ascii: bool = False

    def settled(self, format_: SerialFormat, *, ascii: bool) -> SerialLink:  # noqa: A002
        """Return the serial link with these ports and the settings that were found by listening.

        `ascii` is True if the line carries ASCII, False if it carries RTU.
        """
        return SerialLink(self.ports[0], format_, ascii, *self.ports[1:])

    @property
    def name(self) -> str:
        return self.settled(SerialFormat(), ascii=False).name

    def __str__(self) -> str:
        return f"{'ascii' if self.only_ascii else 'rtu'}:{','.join(self.ports)}@{AUTO}"


@dataclass(frozen=True, slots=True)
class InterfaceLink:
    """One network interface to capture, or several that belong to one network."""

    interfaces: tuple[str, ...]

    @property
    def name(self) -> str:
        return "+".join(self.interfaces)

    def __str__(self) -> str:
        return f"net:{','.join(self.interfaces)}"


@dataclass(frozen=True, slots=True)
class ListenTls:
    """TLS between masters and a tap: the files that the tap needs, all in PEM format."""

    cert: str
    """The file with the tap's certificate, followed by the certificates between it and its CA."""
    key: str | None = None
    """The file with the private key; None if the key is in the file of the certificate."""
    ca: str | None = None
    """The file with the certificate of the CA that must have signed the masters' certificates; None
    if masters need no certificate."""


@dataclass(frozen=True, slots=True)
class TargetTls:
    """TLS between a tap and its target: the files that the tap needs, all in PEM format."""

    ca: str | None
    """The file with the certificate of the CA that must have signed the target's certificate; None
    if the target's certificate is not checked."""
    cert: str | None = None
    key: str | None = None
    name: str | None = None
    """The name that the target's certificate must have; None for the host in the link."""


@dataclass(frozen=True, slots=True)
class TapLink:
    """A TCP relay (tap) that listens at one endpoint and connects to another, the target."""

    listen: Endpoint
    target: Endpoint
    listen_tls: ListenTls | None = field(default=None, kw_only=True)
    target_tls: TargetTls | None = field(default=None, kw_only=True)
    read_only: bool = field(default=False, kw_only=True)
    """True if the tap passes on only requests that change nothing in the slave."""
    is_rtu: bool = field(default=False, kw_only=True)
    """True if the target speaks RTU over TCP. Only a read-only tap, which parses requests, needs
    this."""

    @property
    def tls_sides(self) -> tuple[str, ...]:
        """The sides of the tap that use TLS: `master`, `slave`, both or none."""
        sides = (("master", self.listen_tls), ("slave", self.target_tls))
        return tuple(name for name, tls in sides if tls is not None)

    @property
    def name(self) -> str:
        return self.target.host if self.target.port == MODBUS_PORT else str(self.target)

    def __str__(self) -> str:
        return f"tap:{self.listen}={self.target}"


@dataclass(frozen=True, slots=True)
class TcpLink:
    """An endpoint that speaks Modbus/TCP or RTU over TCP, or the same over UDP."""

    endpoint: Endpoint
    rtu: bool = False
    """True for RTU frames with a CRC, False for ADUs with an MBAP header."""
    is_udp: bool = field(default=False, kw_only=True)

    @property
    def name(self) -> str:
        return str(self.endpoint)

    def __str__(self) -> str:
        return f"{'rtu+' if self.rtu else ''}{'udp' if self.is_udp else 'tcp'}:{self.endpoint}"


LinkSpec = SerialLink | AutoLink | InterfaceLink | TapLink | TcpLink


def parse_link(text: str, offer: str = _ALL) -> LinkSpec:
    """Parse a LINK string. Raises UsageError if it has none of the forms in docs/links.md.

    `offer` is a text with the forms of LINK that the error message proposes.
    """
    scheme, colon, rest = text.partition(":")
    if not colon or not rest:
        raise UsageError(f"link {text!r}: write {offer}")
    match scheme:
        case "rtu" | "ascii":
            return _parse_serial(text, scheme, rest)
        case "rtutap" | "asciitap":
            return _parse_relay(text, scheme, rest)
        case "net":
            return _parse_interfaces(text, rest)
        case "tap":
            listen, equals, target = rest.partition("=")
            if not equals:
                raise UsageError(
                    f"link {text!r}: a tap needs where to listen and whom to call, "
                    "for example tap:127.0.0.1:1502=10.0.0.9:502"
                )
            tap = TapLink(_parse_endpoint(text, listen), _parse_endpoint(text, target))
            _demand_other_target(text, tap)
            return tap
        case "tcp" | "rtu+tcp" | "udp" | "rtu+udp":
            is_rtu, is_udp = scheme.startswith("rtu+"), scheme.endswith("udp")
            return TcpLink(_parse_endpoint(text, rest), is_rtu, is_udp=is_udp)
        case _:
            raise UsageError(f"link {text!r}: write {offer}")


def _parse_serial(
    text: str, scheme: str, rest: str, example: str | None = None
) -> SerialLink | AutoLink:
    """Parse `rest`, which is `PORT@SETTINGS` or `PORT,PORT@SETTINGS`; `scheme` is rtu or ascii.

    Raises UsageError for any other text. The error shows `text`, the whole LINK, and `example`, a
    correct link; None means an example with /dev/ttyUSB0.
    """
    listed, at, settings = rest.rpartition("@")
    ports = (listed if at else rest).split(",")
    is_ascii = scheme == "ascii"
    if not all(PurePath(port).name for port in ports):
        example = example or f"{scheme}:/dev/ttyUSB0@19200-8E1"
        raise UsageError(f"link {text!r}: no port is named, for example {example}")
    if len(ports) > 2 or len(set(ports)) < len(ports):
        raise UsageError(
            f"link {text!r}: a line has one tap, or two different ones, the first on the master's "
            f"side, for example {scheme}:/dev/ttyUSB0,/dev/ttyUSB1@19200-8E1"
        )
    first, comma, _ = settings.partition(",")
    if first.lower() == AUTO and at:
        if comma and example is None:
            raise UsageError(
                f"link {text!r}: {AUTO} takes no silences; give them with --t1-5 and --t3-5, "
                f"for example {text.removesuffix(settings)}{AUTO} --t3-5 5ms"
            )
        return AutoLink(tuple(ports), is_ascii)
    format_ = SerialFormat.parse(settings) if at else SerialFormat.usual(is_ascii=is_ascii)
    if not is_ascii:
        format_.demand_rtu(f"link {text!r}", example or f"{scheme}:{','.join(ports)}@19200-8E1")
    return SerialLink(ports[0], format_, is_ascii, *ports[1:])


def _parse_relay(text: str, scheme: str, rest: str) -> SerialLink:
    """Parse `rest`, which is `PORT@SETTINGS=PORT`: the master's and the slaves' port.

    The settings are those of both ports. `scheme` is rtutap or asciitap; `text` is the whole LINK,
    for error messages. Raises UsageError if `rest` has another form or names one port twice.
    """
    master_side, equals, slave_port = rest.rpartition("=")
    is_ascii = scheme == "asciitap"
    example = f"{scheme}:/dev/ttyUSB0@{SerialFormat.usual(is_ascii=is_ascii)}=/dev/ttyUSB1"
    if not equals or not PurePath(slave_port).name:
        raise UsageError(
            f"link {text!r}: a tap needs the port on the master's side and the port on the "
            f"slaves' side, for example {example}"
        )
    if "@" in slave_port:
        raise UsageError(
            f"link {text!r}: the settings are those of both ports and stand behind the first, "
            f"for example {example}"
        )
    line = _parse_serial(text, "ascii" if is_ascii else "rtu", master_side, example)
    if isinstance(line, AutoLink):
        raise UsageError(
            f"link {text!r}: a cut line says nothing until it is relayed, so its settings cannot "
            f"be found; give them, for example {example}"
        )
    if slave_port in line.ports or line.slave_port is not None:
        raise UsageError(f"link {text!r}: a tap joins two different ports, for example {example}")
    return replace(line, slave_port=slave_port, is_relay=True)


def _parse_interfaces(text: str, rest: str) -> InterfaceLink:
    names = tuple(rest.split(","))
    if not all(names) or len(names) > MAX_INTERFACES or len(set(names)) < len(names):
        raise UsageError(
            f"link {text!r}: name an interface, or up to {MAX_INTERFACES} different ones that hear "
            "one network, for example net:eth0,eth1"
        )
    if ANY_INTERFACE in names[1:] or names[0] == ANY_INTERFACE != rest:
        raise UsageError(f"link {text!r}: any is all interfaces; name it alone, or those you mean")
    return InterfaceLink(names)


def _parse_endpoint(text: str, part: str) -> Endpoint:
    match = _ENDPOINT.fullmatch(part)
    port = int(match["port"] or MODBUS_PORT) if match is not None else 0
    if port > 65535:
        raise UsageError(f"link {text!r}: port {port} is above 65535, the highest there is")
    if match is None:
        raise UsageError(
            f"link {text!r}: {part!r} is no address; write HOST:PORT, "
            "for example 127.0.0.1:1502 or [::1]:1502"
        )
    host = match["host"] or match["bracketed"]
    if host.isdecimal():
        # A host of digits only is refused: the system would take 1502 as the address 0.0.5.222.
        raise UsageError(
            f"link {text!r}: {part!r} names no host; write HOST:PORT, "
            f"for example 127.0.0.1:{match['port'] or host}"
        )
    return Endpoint(host, port)


def _demand_other_target(text: str, tap: TapLink) -> None:
    """Raise UsageError if a tap's target is the tap itself, or has port 0.

    `text` is the whole LINK, for the error message.
    """
    listen, target = tap.listen, tap.target
    if target.port == 0:
        raise UsageError(
            f"link {text!r}: nothing listens at port 0; name the slave's port, "
            f"for example tap:{listen}={Endpoint(target.host, MODBUS_PORT)}"
        )
    itself = (listen.host, *_OWN_ADDRESSES.get(listen.host, ()))
    if listen.port == target.port and target.host in itself:
        raise UsageError(
            f"link {text!r}: the tap would call itself; let it listen at another port, "
            f"for example tap:{Endpoint(listen.host, 0)}={target}, where 0 takes a free one"
        )


# The value of `--link` for a file of serial bytes: a line's settings, without a port.
#
#     rtu@19200-8E1      RTU; `rtu` alone means rtu@19200-8E1
#     ascii@9600-7E1     ASCII; `ascii` alone means ascii@9600-7E1

_MODES = ("rtu", "ascii")


@dataclass(frozen=True, slots=True)
class LineSettings:
    """The baud rate and character format of a serial line, and its mode: RTU or ASCII."""

    format: SerialFormat
    ascii: bool = False

    def link_at(self, port: str) -> SerialLink:
        """Return the serial link with this port and these settings."""
        return SerialLink(port, self.format, ascii=self.ascii)

    def __str__(self) -> str:
        return f"{'ascii' if self.ascii else 'rtu'}@{self.format}"


def parse_line(text: str) -> LineSettings:
    """Read `rtu@19200-8E1` or `ascii@9600-7E1`.

    Raises UsageError for any other text, and for settings that the line cannot have.
    """
    mode, at, settings = text.partition("@")
    if mode not in _MODES:
        port = " without a port" if ":" in mode else ""
        raise UsageError(
            f"--link {text!r}: say of the line of a file{port}: rtu@19200-8E1 or ascii@9600-7E1"
        )
    is_ascii = mode == "ascii"
    format_ = SerialFormat.parse(settings) if at else SerialFormat.usual(is_ascii=is_ascii)
    if not is_ascii:
        format_.demand_rtu(f"--link {text!r}", "rtu@19200-8E1")
    return LineSettings(format_, is_ascii)

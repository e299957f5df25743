"""The LINK strings of the command line, read in one place. docs/links.md is their page."""

#     rtu:/dev/ttyUSB0@19200-8E1         serial RTU
#     ascii:/dev/ttyUSB0@9600-7E1        serial ASCII
#     net:eth0                           a network interface
#     tap:127.0.0.1:1502=10.0.0.9:502    an in-line TCP relay: where to listen, whom to call
#     tcp:127.0.0.1:1502                 a Modbus/TCP endpoint
#     rtu+tcp:127.0.0.1:1502             the same with RTU frames
#
# An IPv6 address stands in brackets: tcp:[::1]:1502.

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePath

from mbtool.core.errors import UsageError
from mbtool.core.evidence import Endpoint
from mbtool.core.serial_format import SerialFormat

MODBUS_PORT = 502

_HOST = re.compile(r"[^\s/@\[\]]+")
_PORT = re.compile(r"\d{1,5}", re.ASCII)

_ASCII_FORMAT = SerialFormat(9600, 7, "E", 1)


@dataclass(frozen=True, slots=True)
class SerialLink:
    """A serial port that carries RTU or ASCII."""

    port: str
    format: SerialFormat
    ascii: bool = False

    @property
    def name(self) -> str:
        return PurePath(self.port).name

    def __str__(self) -> str:
        return f"{'ascii' if self.ascii else 'rtu'}:{self.port}@{self.format}"


@dataclass(frozen=True, slots=True)
class InterfaceLink:
    """A network interface to listen on."""

    interface: str

    @property
    def name(self) -> str:
        return self.interface

    def __str__(self) -> str:
        return f"net:{self.interface}"


@dataclass(frozen=True, slots=True)
class TapLink:
    """A relay that listens at one endpoint and passes on to another."""

    listen: Endpoint
    target: Endpoint

    @property
    def name(self) -> str:
        return self.target.host if self.target.port == MODBUS_PORT else str(self.target)

    def __str__(self) -> str:
        return f"tap:{self.listen}={self.target}"


@dataclass(frozen=True, slots=True)
class TcpLink:
    """An endpoint that speaks Modbus/TCP, or RTU over TCP."""

    endpoint: Endpoint
    rtu: bool = False

    @property
    def name(self) -> str:
        return str(self.endpoint)

    def __str__(self) -> str:
        return f"{'rtu+tcp' if self.rtu else 'tcp'}:{self.endpoint}"


LinkSpec = SerialLink | InterfaceLink | TapLink | TcpLink


def parse_link(text: str) -> LinkSpec:
    """Read a LINK string. Raises UsageError."""
    scheme, colon, rest = text.partition(":")
    if not colon or not rest:
        raise _unknown(text)
    match scheme:
        case "rtu" | "ascii":
            return _parse_serial(text, scheme, rest)
        case "net":
            return InterfaceLink(rest)
        case "tap":
            listen, equals, target = rest.partition("=")
            if not equals:
                raise UsageError(
                    f"link {text!r}: a tap needs where to listen and whom to call, "
                    "for example tap:127.0.0.1:1502=10.0.0.9:502"
                )
            return TapLink(_parse_endpoint(text, listen), _parse_endpoint(text, target))
        case "tcp" | "rtu+tcp":
            return TcpLink(_parse_endpoint(text, rest), rtu=scheme == "rtu+tcp")
        case _:
            raise _unknown(text)


def _parse_serial(text: str, scheme: str, rest: str) -> SerialLink:
    port, at, settings = rest.rpartition("@")
    if not at:
        port = rest
    if not PurePath(port).name:
        raise UsageError(
            f"link {text!r}: no port is named, for example {scheme}:/dev/ttyUSB0@19200-8E1"
        )
    if "," in port:
        raise UsageError(f"link {text!r}: two taps on one line are not supported; name one port")
    if at:
        format_ = SerialFormat.parse(settings)
    else:
        format_ = _ASCII_FORMAT if scheme == "ascii" else SerialFormat()
    if scheme == "rtu" and format_.data_bits != 8:  # Serial Line V1.02, 2.5.1.
        raise UsageError(f"link {text!r}: RTU needs 8 data bits, for example {port}@19200-8E1")
    return SerialLink(port, format_, ascii=scheme == "ascii")


def _parse_endpoint(text: str, part: str) -> Endpoint:
    host, colon, port = part.rpartition(":")
    if part.startswith("[") and part.endswith("]"):
        host, colon, port = part, ":", str(MODBUS_PORT)
    elif not colon:
        host, port = part, str(MODBUS_PORT)
    bracketed = host.startswith("[") and host.endswith("]")
    bare = host[1:-1] if bracketed else host
    valid_host = _HOST.fullmatch(bare) is not None and (bracketed or ":" not in bare)
    if not valid_host or _PORT.fullmatch(port) is None or int(port) > 65535:
        raise UsageError(
            f"link {text!r}: {part!r} is no address; write HOST:PORT, "
            "for example 127.0.0.1:1502 or [::1]:1502"
        )
    return Endpoint(bare, int(port))


def _unknown(text: str) -> UsageError:
    return UsageError(
        f"link {text!r}: write rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, net:INTERFACE, "
        "tap:LISTEN=TARGET, tcp:HOST:PORT or rtu+tcp:HOST:PORT"
    )

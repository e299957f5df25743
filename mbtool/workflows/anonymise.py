"""Copies captures without addresses, names and texts of the plant: `convert --anonymous`."""

# The packets and bytes of the captures are read, their addresses, names and texts are replaced
# (core/pseudonyms.py, shared/anonymous_packets.py), and the result is written to a temporary log.
# This log is then converted like any other log. So the transactions of the copy are decoded from
# the replaced bytes, and no decoded text of the original gets into it. The copy keeps only these
# metadata: line settings, ports and built-in profiles.

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from heapq import merge
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import (
    Chunk,
    Connection,
    Endpoint,
    InputError,
    LinkSpec,
    Packet,
    UsageError,
    WireEvent,
    parse_link,
)
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.link_spec import SerialLink, TapLink
from mbtool.core.pseudonyms import Pseudonyms
from mbtool.devices import builtin_profiles, parse_who
from mbtool.logs.layout import EVIDENCE_ONLY
from mbtool.logs.links import ACROSS, PORTS, RTU_PORTS, SPEC
from mbtool.logs.writer import LogWriter
from mbtool.modbus import Transport
from mbtool.workflows.convert import Conversion
from mbtool.workflows.shared.anonymous_packets import AnonymousChoice, AnonymousPackets
from mbtool.workflows.shared.pcapng_output import NumberedPacket, Shown
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading_options import ReadingOptions
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from mbtool.packets import CaptureHead
    from mbtool.workflows.shared.wire_streams import WirePiece

KEY_BYTES = 32
MOST_KEY_BYTES = 65_536


def read_key(path: str | None) -> bytes:
    """Return the key in a file, or a new one that nobody keeps. Raises InputError, UsageError."""
    if path is None:
        return secrets.token_bytes(KEY_BYTES)
    try:
        with open(path, "rb") as file:
            key = file.read(MOST_KEY_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path}: the key cannot be read: {error.strerror}") from error
    if len(key) > MOST_KEY_BYTES:
        raise UsageError(f"{path}: a key has at most {MOST_KEY_BYTES:,} bytes")
    if not key.strip():
        raise UsageError(f"{path}: empty; a key is any text that nobody can guess")
    return key


@contextmanager
def anonymous_conversion(
    conversion: Conversion, key: bytes, choice: AnonymousChoice, watch: Watch = unwatched
) -> Iterator[Conversion]:
    """Yield the conversion of an anonymous copy of what `conversion` reads.

    The copy is in a temporary folder until the context ends.
    """
    copy = _Copy(conversion, key, choice)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "anonymous.mcap")
        copy.write(path)
        yield Conversion(
            [str(path)], ReadingOptions(), TimeWindow.parse(None, None), watch=watch, anonymous=True
        )


class _Copy:
    """Writes the evidence of a conversion to a log, with everything replaced."""

    def __init__(self, conversion: Conversion, key: bytes, choice: AnonymousChoice) -> None:
        self._conversion = conversion
        self._pseudonyms = Pseudonyms(key)
        self._choice = choice
        self._links: dict[str, str] = {}
        """The new name of each link of a line or interface, by its name."""

    def write(self, path: Path) -> None:
        shown = self._conversion.evidence()
        head = self._conversion.head()
        rtu_ports = _ports(head, RTU_PORTS)
        ports = {MODBUS_PORT, *_ports(head, PORTS), *rtu_ports, *self._conversion.modbus_ports}
        packets = AnonymousPackets(self._pseudonyms, ports, rtu_ports, self._choice)
        capture = {key: value for key, value in head.capture.items() if key == ACROSS}
        with LogWriter(path, capture={EVIDENCE_ONLY: "true", **capture}) as log:
            for name, settings in head.links.items():
                self._links[name] = self._link(name, settings)
                log.add_link(self._links[name], self._settings(name, settings))
            for who, profile in self._devices(head).items():
                log.add_device(who, profile)
            for name in sorted(set(self._devices(head).values())):
                log.add_profile(name, head.profiles[name])
            items = self._conversion.reads(self._replace_content(one, packets) for one in shown)
            events = sorted(self._conversion.events(), key=lambda one: one.ts_ns)
            for item in merge(items, events, key=lambda one: one.ts_ns):
                if isinstance(item, WireEvent):
                    log.write(self._event(item, packets))
                else:
                    log.write(self._anonymous_item(item))

    def _replace_content(self, one: Shown, packets: AnonymousPackets) -> Shown:
        """Return a packet or the bytes of a link with their content replaced."""
        if isinstance(one, NumberedPacket):
            packet = replace(one.packet, data=packets.replaced(one.packet))
            return NumberedPacket(packet, ())
        return one._replace(data=_replaced_bytes(one, packets))

    def _anonymous_item(self, item: Packet | Chunk) -> Packet | Chunk:
        """Return a packet or a read at its new time and with the new names of its link and ends."""
        ts_ns = item.ts_ns - self._pseudonyms.shift_ns
        ts_ns = ts_ns if ts_ns >= 0 else item.ts_ns
        if isinstance(item, Packet):
            link = self._known_link(item.link, "if")
            return replace(item, ts_ns=ts_ns, link=link, file="", number=0)
        if item.connection is None:
            link = self._known_link(item.link, "line")
            return replace(item, ts_ns=ts_ns, link=link, place=None)
        connection = Connection(
            self._end(item.connection.master),
            self._end(item.connection.slave),
            item.connection.number,
        )
        return replace(item, ts_ns=ts_ns, link=connection.link, connection=connection, place=None)

    def _event(self, event: WireEvent, packets: AnonymousPackets) -> WireEvent:
        """Return an event at its new time, with new names in all its texts."""
        names = {event.link: self._links.get(event.link) or self._endpoint(event.link)}
        for end in (event.source, event.destination):
            if end:
                names[end] = self._endpoint(end)
        message = event.message
        for name in sorted(filter(None, names), key=len, reverse=True):
            message = message.replace(name, names[name])
        ts_ns = event.ts_ns - self._pseudonyms.shift_ns
        return replace(
            event,
            ts_ns=ts_ns if ts_ns >= 0 else event.ts_ns,
            link=names[event.link],
            message=message,
            source=names.get(event.source, ""),
            destination=names.get(event.destination, ""),
            raw=packets.other(event.raw),
        )

    def _endpoint(self, text: str) -> str:
        """Return the new name of a host, or of a host with its port."""
        host, colon, port = text.rpartition(":")
        if not text or not colon or not port.isdecimal():
            return self._pseudonyms.host(text) if text else ""
        return str(Endpoint(self._pseudonyms.host(host.strip("[]")), int(port)))

    def _end(self, end: Endpoint) -> Endpoint:
        return Endpoint(self._pseudonyms.host(end.host), end.port)

    def _known_link(self, name: str, kind: str) -> str:
        """Return the new name of a link; it is made from `kind` if the capture does not name it."""
        if name not in self._links:
            self._links[name] = self._pseudonyms.name(kind, name)
        return self._links[name]

    def _link(self, name: str, settings: dict[str, str]) -> str:
        """Return the new name of a link: that of a serial line is made from its number."""
        link = _parse_link(settings)
        if isinstance(link, TapLink):
            return self._tap(link).name
        is_serial = isinstance(link, SerialLink) or not settings
        return self._pseudonyms.name("line" if is_serial else "net", name)

    def _tap(self, link: TapLink) -> TapLink:
        return TapLink(self._end(link.listen), self._end(link.target))

    def _settings(self, name: str, settings: dict[str, str]) -> dict[str, str]:
        """Return those settings of a link that show only how to decode it."""
        kept = {key: value for key, value in settings.items() if key in (PORTS, RTU_PORTS)}
        link = _parse_link(settings)
        if isinstance(link, SerialLink):
            kept[SPEC] = str(SerialLink(self._link(name, settings), link.format, ascii=link.ascii))
        elif isinstance(link, TapLink):
            kept[SPEC] = str(self._tap(link))
        return kept

    def _devices(self, head: CaptureHead) -> dict[str, str]:
        """Return the devices whose profiles are built in, under their new addresses."""
        built_in = set(builtin_profiles())
        devices = {}
        for text, profile in head.devices.items():
            if profile in built_in and profile in head.profiles:
                who = parse_who(text)
                host = None if who.host is None else self._pseudonyms.host(who.host)
                unit = who.unit
                if self._choice.units and unit is not None:
                    unit = self._pseudonyms.unit(unit)
                devices[str(replace(who, host=host, unit=unit))] = profile
        return devices


def _replaced_bytes(piece: WirePiece, packets: AnonymousPackets) -> bytes:
    if piece.frame is None:
        return packets.other(piece.data)
    replaced: dict[Transport, Callable[[bytes], bytes]] = {
        Transport.RTU: packets.rtu,
        Transport.RTU_TCP: packets.rtu,
        Transport.ASCII: packets.ascii,
        Transport.TCP: packets.mbap,
    }
    made = replaced[piece.frame.transport.over_tcp](piece.data)
    return made if len(made) == len(piece.data) else packets.other(piece.data)


def _parse_link(settings: Mapping[str, str]) -> LinkSpec | None:
    """The LINK that the settings of a link name; None if they name none that can be read."""
    try:
        return parse_link(settings[SPEC])
    except (UsageError, KeyError):
        return None


def _ports(head: CaptureHead, key: str) -> set[int]:
    texts = (one.get(key, "") for one in head.links.values())
    return {int(port) for text in texts for port in text.split() if port.isdecimal()}

"""Writes network packets, and the frames of serial lines and taps, as pcapng for Wireshark."""

# packets/line_packets.py explains how a frame becomes a packet. Each link becomes two interfaces:
# one for its frames, one for the bytes that are no frame. Verdicts, findings and the messages of
# events are written as comments of the packets. Requests are marked outbound and responses inbound,
# as seen from the master.
#
# A request gets the time of its last byte, a response that of its first byte, so that Wireshark
# shows the same latency as mbtool.

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import msgspec

from mbtool.core import Connection, Direction, EventKind, Packet
from mbtool.logs.links import SPEC
from mbtool.modbus import Transport
from mbtool.modbus.adu import read_frame
from mbtool.packets.capture_writer import (
    CRC_ERROR,
    RECEIVED,
    SENT,
    InterfaceSettings,
    PcapngWriter,
)
from mbtool.packets.line_packets import (
    LOCAL_BLOCK,
    LOCAL_OPTION,
    MASTER_PORT,
    MAX_LINK_NUMBER,
    RAW_IPV4,
    RTAC_SERIAL,
    LineEnds,
    WireReads,
    line_datagram,
    rtac_packet,
    with_mbap,
)
from mbtool.workflows.shared.wire_streams import StreamKey, WireFrame, WirePiece

if TYPE_CHECKING:
    from mbtool.packets import CaptureHead
    from mbtool.workflows.shared.conversion_inputs import InputGroup


class NumberedPacket(NamedTuple):
    """A network packet, and the comments to write with it."""

    packet: Packet
    comments: Sequence[str]

    @property
    def ts_ns(self) -> int:
        return self.packet.ts_ns


Shown = NumberedPacket | WirePiece


@dataclass(slots=True)
class Converted:
    """The numbers of packets, reads of ports and transactions that a conversion has written."""

    packets: int = 0
    reads: int = 0
    transactions: int = 0
    points: int = 0
    """The number of values of named points in these transactions, if a log was written."""


class PieceWriter:
    """Writes the frames of serial lines and taps, and the bytes between frames, as packets."""

    def __init__(self, stream: BinaryIO, head: CaptureHead) -> None:
        self.writer = PcapngWriter(stream)
        self.head = head
        self.numbers: dict[str, int] = {}
        """For each link whose frames become packets, a number. The IPv4 addresses of the link's
        master and slaves are made from this number."""
        self._ports: dict[Connection, int] = {}

    def add_link(self, link: str) -> None:
        """Give a link its number, if it has none yet."""
        if link not in self.numbers:
            self.numbers[link] = len(self.numbers) % MAX_LINK_NUMBER + 1

    def names(self, link: str, units: Iterable[int]) -> dict[bytes, str]:
        """Return names for the master and the slaves (`units`) of a link. The key is the IPv4
        address (4 bytes) that stands for each of them.
        """
        names: dict[bytes, str] = {}
        name = "".join(one if one.isalnum() else "-" for one in PurePath(link).name)
        for unit in sorted(set(units)):
            ends = LineEnds.of(self.numbers[link], unit)
            names[ends.master] = f"master.{name}"
            names[ends.slave] = f"unit{unit}.{name}"
        return names

    def write_piece(self, piece: WirePiece) -> None:
        shown = None if piece.frame is None else self._datagram(piece.key, piece.frame)
        if shown is None or piece.frame is None:
            self._write_bytes(piece)
            return
        frame = piece.frame
        reads = self._reads(piece, skip=shown.skip, raw=shown.raw)
        direction = SENT if frame.is_request else RECEIVED
        self.describe(piece.key.link, RAW_IPV4)
        self._write_packet(piece, RAW_IPV4, shown.data, frame.comments, direction, reads)

    def _write_bytes(self, piece: WirePiece) -> None:
        """Write bytes that are no frame as one packet, on the interface that the link has for such
        bytes.
        """
        skipped = piece.skipped
        by_master = piece.key.direction is Direction.REQUEST
        data = rtac_packet(piece.ts_ns, piece.data, by_master=by_master)
        comments = () if skipped is None else (skipped.message,)
        is_damaged = skipped is not None and skipped.kind is EventKind.BAD_CHECK
        self.describe(piece.key.link, RTAC_SERIAL)
        flags = CRC_ERROR if is_damaged else 0
        self._write_packet(piece, RTAC_SERIAL, data, comments, flags, self._reads(piece))

    def _write_packet(
        self,
        piece: WirePiece,
        link_type: int,
        data: bytes,
        comments: Sequence[str],
        flags: int,
        reads: WireReads,
    ) -> None:
        packet = Packet(
            ts_ns=max(piece.ts_ns, 0),
            link=piece.key.link,
            link_type=link_type,
            data=data,
            original_length=len(data),
        )
        local = {LOCAL_OPTION: msgspec.json.encode(reads)}
        self.writer.write(packet, comments=comments, flags=flags, local=local)

    def _reads(self, piece: WirePiece, skip: int = 0, raw: bytes | None = None) -> WireReads:
        return WireReads(
            reads=piece.reads,
            is_open=piece.is_open,
            skip=skip,
            raw=raw,
            direction=piece.chunk.direction,
            stamp=piece.chunk.stamp,
            connection=piece.chunk.connection,
        )

    def _datagram(self, key: StreamKey, frame: WireFrame) -> _Datagram | None:
        """Make the IP datagram that shows a frame in Wireshark; None for an ASCII frame that is
        malformed.
        """
        raw, skip, original = frame.raw, 6, None
        if frame.transport.has_mbap:
            payload, skip = raw, 0
        elif frame.transport is Transport.ASCII:
            read = read_frame(raw)
            if read is None:
                return None
            check = bytes((read.checksum.received,))
            payload, original = with_mbap(frame.number, read.body, check), raw
        else:
            payload = with_mbap(frame.number, raw[:-2], raw[-2:])
        ends = LineEnds.of(self.numbers[key.link], frame.unit, self._master_port(key))
        data = line_datagram(ends, frame.number, payload, is_request=frame.is_request)
        return _Datagram(data, skip, original)

    def _master_port(self, key: StreamKey) -> int:
        """The UDP port that stands for the master. For a tap, each TCP connection gets a port of
        its own.
        """
        if key.connection is None:
            return MASTER_PORT
        count = len(self._ports)
        return self._ports.setdefault(key.connection, MASTER_PORT + count % 40_000)

    def describe(self, link: str, link_type: int) -> None:
        """Write the description of a link's interface with this link type, if it is not written
        yet.
        """
        if self.writer.knows(link, link_type):
            return
        spec = self.head.links.get(link, {}).get(SPEC, link)
        what = "frames as Modbus over UDP" if link_type == RAW_IPV4 else "bytes that are no frame"
        settings = InterfaceSettings(f"{spec}: {what}", _baud(spec))
        self.writer.add_interface(link, link_type, settings)


class PcapngOutput:
    """Writes one pcapng file: network packets, frames, and bytes between frames."""

    def __init__(self, stream: BinaryIO, groups: Sequence[InputGroup], head: CaptureHead) -> None:
        self._pieces = PieceWriter(stream, head)
        self._groups = groups
        self._done = Converted()

    def write(self, shown: Iterable[Shown]) -> Converted:
        self._number_links()
        pieces, writer = self._pieces, self._pieces.writer
        is_plain = not pieces.numbers and not pieces.head.devices and not pieces.head.links
        if not is_plain or any(group.is_log for group in self._groups):
            writer.write_block(LOCAL_BLOCK, msgspec.json.encode(pieces.head))
        writer.write_names(self._names())
        for one in shown:
            if isinstance(one, NumberedPacket):
                writer.write(one.packet, comments=one.comments)
            else:
                pieces.write_piece(one)
            self._done.packets += 1
        return self._done

    def _number_links(self) -> None:
        for link in [link for group in self._groups for link in group.marks.spans]:
            self._pieces.add_link(link)
        for link in [key.link for group in self._groups for key in group.marks.frames]:
            self._pieces.add_link(link)

    def _names(self) -> dict[bytes, str]:
        """The names of all masters and slaves; the key is the IPv4 address (4 bytes) that stands
        for each of them.
        """
        names: dict[bytes, str] = {}
        for group in self._groups:
            for key, frames in group.marks.frames.items():
                names |= self._pieces.names(key.link, (frame.unit for frame in frames))
        return names


class _Datagram(NamedTuple):
    data: bytes
    skip: int
    """The number of payload bytes before the frame's own bytes."""
    raw: bytes | None
    """The captured characters of an ASCII frame, as the datagram has it in binary; None for other
    frames."""


def _baud(spec: str) -> int:
    """The baud rate in a LINK text such as `rtu:COM3@9600`; 0 if the text has none."""
    digits = spec.rpartition("@")[2].partition("-")[0]
    return int(digits) if digits.isdecimal() and len(digits) <= 8 else 0

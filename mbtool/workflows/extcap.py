"""Writes the frames of a serial line as packets, for a live capture with Wireshark."""

# Wireshark starts `mbtool extcap` and reads pcapng from a named pipe. Each frame becomes a packet
# as with `convert` (packets/line_packets.py). It is written when its transaction has ended: with
# the response, or when no response has come. Bytes that are no frame become packets of the second
# interface. The output is flushed after each record.
#
# An option of each packet tells mbtool by which reads of the port the bytes came. The real reads
# are not known when the frame is written. So the option claims one read that ends with the last
# byte of the frame. `decode` can read the file that Wireshark saves, but it lacks the silences
# inside frames.

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import msgspec

from mbtool.core import Chunk, Direction, SerialLink, Stamp, WireEvent
from mbtool.devices import Assignments, NamedTransaction, profile_to_json
from mbtool.logs.links import SPEC
from mbtool.modbus.adu import DirectionBy
from mbtool.packets import CaptureHead
from mbtool.packets.line_packets import LOCAL_BLOCK, RAW_IPV4, RTAC_SERIAL
from mbtool.workflows.shared.evidence_reading import comments_of, frames_of
from mbtool.workflows.shared.pcapng_output import PieceWriter
from mbtool.workflows.shared.wire_streams import SkippedBytes, StreamKey, WireFrame, WirePiece

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record


class LivePackets:
    """Writes the frames of one serial line, and the bytes between them, as pcapng."""

    def __init__(self, stream: BinaryIO, link: SerialLink, assignments: Assignments) -> None:
        """Write the head of the file to `stream`: the link, devices and profiles, and two
        interfaces. One is for frames, the other for bytes that are no frame.
        """
        self._stream = stream
        self._assignments = assignments
        self._transactions = 0
        self._named: set[int] = set()
        self._pieces = PieceWriter(stream, _head(link, assignments))
        self._pieces.add_link(link.name)
        self._pieces.writer.write_block(LOCAL_BLOCK, msgspec.json.encode(self._pieces.head))
        for link_type in (RAW_IPV4, RTAC_SERIAL):
            self._pieces.describe(link.name, link_type)
        stream.flush()

    def write(self, record: Record) -> None:
        """Write the frames of a transaction, or the bytes of an event that are no frame. Raises
        OSError if the pipe is closed.
        """
        if not isinstance(record, WireEvent):
            self._write_transaction(record)
        elif record.raw:
            self._write_skipped(record)

    def _write_transaction(self, one: NamedTransaction) -> None:
        self._transactions += 1
        if one.unit not in self._named:
            self._named.add(one.unit)
            self._pieces.writer.write_names(self._pieces.names(one.link, [one.unit]))
        comments = comments_of(one, self._assignments.profile_for(one))
        for frame in frames_of(one, self._transactions, comments):
            end_ns = one.request_ns if frame.is_request else one.response_ns
            direction = Direction.UNKNOWN
            if one.direction_by is DirectionBy.PORT:
                direction = Direction.REQUEST if frame.is_request else Direction.RESPONSE
            self._write(one.link, frame.raw, end_ns or frame.ts_ns, direction, frame=frame)
        self._stream.flush()

    def _write_skipped(self, event: WireEvent) -> None:
        about = SkippedBytes(event.raw, event.kind, event.message, event.ts_ns)
        self._write(event.link, event.raw, event.ts_ns, Direction.UNKNOWN, skipped=about)
        self._stream.flush()

    def _write(
        self,
        link: str,
        data: bytes,
        end_ns: int,
        direction: Direction,
        frame: WireFrame | None = None,
        skipped: SkippedBytes | None = None,
    ) -> None:
        stamp = Stamp.LAST_BYTE
        chunk = Chunk(ts_ns=end_ns, link=link, data=data, direction=direction, stamp=stamp)
        key = StreamKey(link, direction, None)
        reads = [(len(data), end_ns)]
        self._pieces.write_piece(WirePiece(key, data, reads, False, chunk, frame, skipped))


def _head(link: SerialLink, assignments: Assignments) -> CaptureHead:
    return CaptureHead(
        capture={"made_by": "mbtool"},
        links={link.name: {SPEC: str(link)}},
        devices={str(one.who): one.profile.name for one in assignments},
        profiles={one.name: profile_to_json(one) for one in assignments.profiles},
    )

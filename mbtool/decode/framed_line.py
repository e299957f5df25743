"""Decodes a serial line from a program's log that has whole frames and names their senders."""

# Each chunk is one frame with a known direction, so no search is needed: it becomes an ADU and goes
# to the pairing. The time of a frame, for its first and last byte alike, is the time at which the
# program noted it. If the log has no times, only the order of the frames is known.
#
# A chunk that is no frame, or a frame with a wrong CRC or LRC, becomes a skipped event.
#
# Memory: that of the pairing.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.decode.connections import skipped_event
from mbtool.decode.pairing import Pairing
from mbtool.decode.transactions import Ends
from mbtool.framing.rtu_lengths import MIN_FRAME, why_skipped
from mbtool.modbus.adu import Adu, Checksum, DirectionBy, Skipped, Transport, crc, read_frame

if TYPE_CHECKING:
    from mbtool.core import Direction, StreamPlace
    from mbtool.decode.connections import Decoded


class FramedLine:
    """Takes whole frames; returns ADUs, transactions and events."""

    def __init__(self, link: str, *, timed: bool) -> None:
        """`timed` is False if the frames have no known times."""
        self._link = link
        self._pairing = Pairing(Ends(link, timed=timed))

    def feed(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None
    ) -> list[Decoded]:
        """Take one frame, which was noted at `ts_ns`; return what it completes."""
        found = _parts(data)
        if found is None or not found[-1].ok:
            kind, reason, check = why_skipped(data, (direction,))
            skipped = Skipped(ts_ns, kind, reason, data, check)
            done = self._pairing.note_skipped(skipped)
            return [*done, skipped_event(skipped, self._link, ("", ""))]
        transport, unit, pdu, checksum = found
        adu = Adu(
            start_ns=ts_ns,
            end_ns=ts_ns,
            transport=transport,
            direction=direction,
            direction_by=DirectionBy.PORT,
            confidence=1.0,
            unit=unit,
            pdu=pdu,
            raw=data,
            checksum=checksum,
            origin=None if place is None else place.origin,
        )
        return [adu, *self._pairing.feed(adu)]

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note silence until `now_ns`; return the transactions that time out."""
        return [*self._pairing.advance(now_ns)]

    def close(self, end_ns: int | None = None) -> list[Decoded]:
        """End the line, whose capture ended at `end_ns`; return its unanswered requests."""
        return [*self._pairing.close(end_ns)]


def _parts(data: bytes) -> tuple[Transport, int, bytes, Checksum] | None:
    """Return the form, the unit, the PDU and the checksum of a frame; None if it is no frame."""
    frame = read_frame(data) if data.startswith(b":") else None
    if frame is not None and len(frame.body) > 1:
        return Transport.ASCII, frame.body[0], frame.body[1:], frame.checksum
    if len(data) < MIN_FRAME:
        return None
    checksum = Checksum(int.from_bytes(data[-2:], "little"), crc(data[:-2]))
    return Transport.RTU, data[0], data[1:-2], checksum

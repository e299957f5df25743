"""Decodes the bytes of one serial line or one TCP connection into transactions."""

# A splitter cuts the bytes into ADUs, then `Pairing` makes transactions of them. The results come
# in the order of the wire: every `Adu`, every `Transaction` as soon as it is complete, and a
# `WireEvent` for everything else, such as skipped bytes.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.core.wording import counted
from mbtool.decode.network_pairing import NetworkPairing
from mbtool.decode.pairing import Pairing
from mbtool.decode.stream_progress import OTHER, AduPlace, StreamProgress
from mbtool.decode.transactions import Ends
from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter
from mbtool.modbus.adu import Adu, Skipped
from mbtool.modbus.transaction import Transaction
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

if TYPE_CHECKING:
    from mbtool.core import Connection, SerialFormat, StreamPlace

Decoded = Adu | Transaction | WireEvent


class Bus:
    """Decodes a serial line on which one tap hears both the master and the slaves."""

    def __init__(
        self,
        link: str,
        line: SerialFormat,
        *,
        ascii: bool = False,  # noqa: A002
        timed: bool = True,
    ) -> None:
        """`timed` is False if the bytes have no known times, as in a raw file."""
        self._ends = Ends(link, timed=timed)
        splitter = AsciiSplitter if ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(line, timed=timed)
        self._pairing = Pairing(self._ends)

    def feed(self, data: bytes, ts_ns: int) -> list[Decoded]:
        """Take the bytes of one read; `ts_ns` is the time of the last one."""
        events = self._splitter.feed(data, ts_ns)
        # Most bytes complete no frame; testing for that here makes RTU decoding 8 % faster.
        return self._paired(events) if events else []

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note that the line was silent from the last byte until `now_ns`."""
        decoded = self._paired(self._splitter.advance(now_ns))
        # Bytes that the splitter still holds may be the response, so no request times out yet.
        return [*decoded, *self._pairing.advance(now_ns)] if self._splitter.is_idle else decoded

    def close(self) -> list[Decoded]:
        """End the line: return everything that is still held."""
        return [*self._paired(self._splitter.close()), *self._pairing.close()]

    def _paired(self, events: list[Adu | Skipped]) -> list[Decoded]:
        return _paired(events, self._pairing, self._ends.link, ("", ""))


class ConnectionDecoder:
    """Decodes a TCP connection between a master and a slave."""

    def __init__(self, connection: Connection, *, rtu: bool = False) -> None:
        splitter = RtuStreamSplitter if rtu else MbapSplitter
        self._link = connection.link
        master, slave = str(connection.master), str(connection.slave)
        self._endpoints = {
            Direction.REQUEST: (master, slave),
            Direction.RESPONSE: (slave, master),
        }
        """The sender and the receiver of each direction."""
        self._splitters = {direction: splitter(direction) for direction in self._endpoints}
        self._pairing = NetworkPairing(Ends(self._link, master, slave))
        self._progress = StreamProgress()
        self._unread = dict.fromkeys(OTHER, 0)
        """By direction, how many bytes the splitter holds. Counted while positions are known."""

    def feed(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None = None
    ) -> list[Decoded]:
        """Take the payload of one segment."""
        events = self._splitters[direction].feed(data, ts_ns)
        if place is None:
            return self._paired(events, direction)
        decoded: list[Decoded] = []
        other = OTHER[direction]
        lost = self._progress.take(direction, other, place, len(data))
        if lost:
            decoded += self._pairing.note_loss(other, lost)
        end = place.position - self._unread[direction]
        self._unread[direction] += len(data)
        for event in events:
            end += len(event.raw)
            self._unread[direction] -= len(event.raw)
            decoded += self._paired([event], direction, AduPlace(end, place.acknowledged))
        return decoded

    def gap(
        self, direction: Direction, missing: int, ts_ns: int, kind: EventKind = EventKind.GAP
    ) -> list[Decoded]:
        """Note that `missing` bytes of one direction are missing here; 0 if the number is unknown.

        `kind` is the event's: GAP or CUT.
        """
        source, destination = self._endpoints[direction]
        lost = WireEvent(
            ts_ns=ts_ns,
            link=self._link,
            kind=kind,
            message=f"{missing or 'an unknown number of'} bytes are missing from the capture",
            source=source,
            destination=destination,
            missing=missing,
        )
        decoded = self._paired(self._splitters[direction].gap(), direction)
        self._unread[direction] = 0
        unexplained = self._progress.skip(direction, missing)
        if unexplained or not missing:
            decoded += self._pairing.note_loss(direction, unexplained)
        return [*decoded, lost]

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note that nothing arrived until `now_ns`."""
        return [*self._pairing.advance(now_ns)]

    def close(self) -> list[Decoded]:
        """End the connection: return everything that is still held."""
        decoded: list[Decoded] = []
        for direction, splitter in self._splitters.items():
            decoded += self._paired(splitter.close(), direction)
        return [*decoded, *self._pairing.close()]

    def _paired(
        self, events: list[Adu | Skipped], direction: Direction, place: AduPlace | None = None
    ) -> list[Decoded]:
        return _paired(events, self._pairing, self._link, self._endpoints[direction], place)


def _paired(
    events: list[Adu | Skipped],
    pairing: Pairing | NetworkPairing,
    link: str,
    endpoints: tuple[str, str],
    place: AduPlace | None = None,
) -> list[Decoded]:
    """Pass ADUs through the pairing; `endpoints` are the sender and receiver of skipped bytes."""
    decoded: list[Decoded] = []
    for event in events:
        if isinstance(event, Adu):
            decoded.append(event)
            decoded += pairing.feed(event, place)
        else:
            decoded += pairing.advance(event.ts_ns)
            decoded.append(skipped_event(event, link, endpoints))
    return decoded


def skipped_event(
    skipped: Skipped, link: str, endpoints: tuple[str, str], speaker: str = ""
) -> WireEvent:
    """Report bytes that were not decoded; `speaker` names their sender on a serial line."""
    amount = counted(len(skipped.raw), "byte") + (f" of {speaker}" if speaker else "")
    return WireEvent(
        ts_ns=skipped.ts_ns,
        link=link,
        kind=skipped.kind,
        message=f"{amount}: {skipped.reason}",
        source=endpoints[0],
        destination=endpoints[1],
        raw=skipped.raw,
    )

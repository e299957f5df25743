"""One link's bytes in, its transactions out: splitters and pairing, joined."""

# What comes out is, in order, every `Adu` of the wire, every `Transaction` as soon as it is
# complete, and a `WireEvent` for all else.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.core.wording import counted
from mbtool.decode.pairing import Pairing
from mbtool.decode.transactions import Ends
from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter
from mbtool.modbus.adu import Adu, Skipped
from mbtool.modbus.transaction import Transaction
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

if TYPE_CHECKING:
    from mbtool.core import Connection, SerialFormat

Decoded = Adu | Transaction | WireEvent


class Bus:
    """A serial line that one tap hears."""

    def __init__(
        self,
        link: str,
        line: SerialFormat,
        *,
        ascii: bool = False,  # noqa: A002
        timed: bool = True,
    ) -> None:
        """`timed` is False where the bytes' times are made up: a file of bytes alone."""
        self._ends = Ends(link, timed=timed)
        splitter = AsciiSplitter if ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(line, timed=timed)
        self._pairing = Pairing(self._ends, bus=True)

    def feed(self, data: bytes, ts_ns: int) -> list[Decoded]:
        """Take the bytes of one read; `ts_ns` is the time of the last one."""
        events = self._splitter.feed(data, ts_ns)
        return self._join(events) if events else []  # Most bytes end nothing.

    def advance(self, now_ns: int) -> list[Decoded]:
        """Learn that the line was silent from the last byte until now."""
        decoded = self._join(self._splitter.advance(now_ns))
        # What the splitter holds may be the response.
        return [*decoded, *self._pairing.advance(now_ns)] if self._splitter.is_idle else decoded

    def close(self) -> list[Decoded]:
        """The capture ends."""
        return [*self._join(self._splitter.close()), *self._pairing.close()]

    def _join(self, events: list[Adu | Skipped]) -> list[Decoded]:
        return _join(events, self._pairing, self._ends, None)


class ConnectionDecoder:
    """A TCP connection between a master and a slave."""

    def __init__(self, connection: Connection, *, rtu: bool = False) -> None:
        splitter = RtuStreamSplitter if rtu else MbapSplitter
        self._ends = Ends(connection.link, str(connection.master), str(connection.slave))
        self._splitters = {
            direction: splitter(direction) for direction in (Direction.REQUEST, Direction.RESPONSE)
        }
        self._pairing = Pairing(self._ends, bus=False)

    def feed(self, direction: Direction, data: bytes, ts_ns: int) -> list[Decoded]:
        """Take the payload of one segment."""
        return self._join(self._splitters[direction].feed(data, ts_ns), direction)

    def gap(
        self, direction: Direction, missing: int, ts_ns: int, kind: EventKind = EventKind.GAP
    ) -> list[Decoded]:
        """Learn that bytes of one direction are missing here; 0 where nobody knows how many."""
        source, destination = _ordered(self._ends, direction)
        lost = WireEvent(
            ts_ns=ts_ns,
            link=self._ends.link,
            kind=kind,
            message=f"{missing or 'an unknown number of'} bytes are missing from the capture",
            source=source,
            destination=destination,
            missing=missing,
        )
        return [*self._join(self._splitters[direction].gap(), direction), lost]

    def advance(self, now_ns: int) -> list[Decoded]:
        """Learn that nothing came until now."""
        return [*self._pairing.advance(now_ns)]

    def close(self) -> list[Decoded]:
        """The connection or the capture ends."""
        decoded: list[Decoded] = []
        for direction, splitter in self._splitters.items():
            decoded += self._join(splitter.close(), direction)
        return [*decoded, *self._pairing.close()]

    def _join(self, events: list[Adu | Skipped], direction: Direction) -> list[Decoded]:
        return _join(events, self._pairing, self._ends, direction)


def _join(
    events: list[Adu | Skipped], pairing: Pairing, ends: Ends, direction: Direction | None
) -> list[Decoded]:
    decoded: list[Decoded] = []
    for event in events:
        if isinstance(event, Adu):
            decoded.append(event)
            decoded += pairing.feed(event)
        else:
            decoded += pairing.advance(event.ts_ns)
            decoded.append(_told(event, ends, direction))
    return decoded


def _told(skipped: Skipped, ends: Ends, direction: Direction | None) -> WireEvent:
    source, destination = _ordered(ends, direction)
    return WireEvent(
        ts_ns=skipped.ts_ns,
        link=ends.link,
        kind=skipped.kind,
        message=f"{counted(len(skipped.raw), 'byte')}: {skipped.reason}",
        source=source,
        destination=destination,
        raw=skipped.raw,
    )


def _ordered(ends: Ends, direction: Direction | None) -> tuple[str, str]:
    """Who sent and who received, where that is known."""
    if direction is None or ends.master is None or ends.slave is None:
        return "", ""
    pair = ends.master, ends.slave
    return pair if direction is Direction.REQUEST else pair[::-1]

"""Decodes bytes that a Python program has read itself, for example from a serial port."""

from __future__ import annotations

from mbtool.api.arguments import Devices, assignments_of
from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    LineSettings,
    Quiet,
    SerialLink,
    Stamp,
    UsageError,
    parse_line,
)
from mbtool.core.limits import MODBUS_PORT
from mbtool.decode.decoder import Decoder, Record
from mbtool.decode.line_timing import LineTiming
from mbtool.devices import Namer
from mbtool.packets import StreamOpened

_STREAMS = {"tcp": False, "rtu+tcp": True}
_LINE, _HOST = "line", "slave"
_FORMS = '"rtu@19200-8E1", "ascii@9600-7E1", "tcp" or "rtu+tcp"'


class ByteDecoder:
    """Turns bytes into transactions and events, as soon as they are complete.

    Bytes never raise: bytes that cannot be read become an event that contains them.
    """

    def __init__(self, link: str = "rtu", *, devices: Devices | None = None) -> None:
        """`link` says where the bytes come from.

        It is a serial line ("rtu@19200-8E1", "ascii@9600-7E1"), or one TCP connection ("tcp",
        "rtu+tcp"). `devices` gives units their profiles: {5: "idec-ft1a-touch"}. Raises UsageError
        if one of them is wrong.
        """
        timing = LineTiming(assignments_of(devices))
        self._connection: Connection | None = None
        self._line: SerialLink | None = None
        self._count = 0
        """Number of bytes that `feed` was given so far."""
        if link in _STREAMS:
            self._connection = Connection(Endpoint("master", 0), Endpoint(_HOST, MODBUS_PORT))
        else:
            self._line = _settings(link).link_at(_LINE)
        self._decoder = Decoder(
            Namer(timing.assignments),
            lines={} if self._line is None else {_LINE: self._line},
            timing=timing,
            ports=(MODBUS_PORT,),
            rtu_ports=(MODBUS_PORT,) if _STREAMS.get(link) else (),
        )
        self._is_begun = False

    def feed(
        self, data: bytes, ts_ns: int | None = None, *, direction: str | None = None
    ) -> list[Record]:
        """Take the next bytes, and return the transactions and events that they complete.

        `ts_ns` is the time at which the last of them was read, in ns since 1970; without it, only
        their order counts. `direction` is "request" or "response"; a TCP connection needs it, a
        serial line with two wires has none. Raises UsageError for another direction.
        """
        self._count += len(data)
        if self._connection is not None:
            return self._feed_stream(self._connection, data, ts_ns or 0, _direction(direction))
        if self._line is None:
            raise RuntimeError("neither a line nor a connection")
        stamp = Stamp.UNKNOWN if ts_ns is None else Stamp.LAST_BYTE
        at_ns = self._count * self._line.format.character_ns if ts_ns is None else ts_ns
        sent = Direction.UNKNOWN if direction is None else _direction(direction)
        return self._decoder.feed(
            Chunk(ts_ns=at_ns, link=_LINE, data=data, stamp=stamp, direction=sent)
        )

    def quiet(self, ts_ns: int) -> list[Record]:
        """Say that nothing has arrived until `ts_ns` (ns since 1970), and return what that ends.

        On a serial line, this silence ends the last frame before the next frame comes.
        """
        if self._line is None:
            return []
        return self._decoder.feed(Quiet(ts_ns, _LINE))

    def close(self) -> list[Record]:
        """End decoding, and return the records that were still pending.

        These are for example the last frame, and a request without its response.
        """
        return self._decoder.close()

    def _feed_stream(
        self, connection: Connection, data: bytes, ts_ns: int, direction: Direction
    ) -> list[Record]:
        records: list[Record] = []
        if not self._is_begun:
            self._is_begun = True
            self._decoder.feed(StreamOpened(ts_ns, connection, joined=False))
        chunk = Chunk(
            ts_ns=ts_ns,
            link=connection.link,
            data=data,
            direction=direction,
            stamp=Stamp.AT_ONCE,
            connection=connection,
        )
        records += self._decoder.feed(chunk)
        return records


def _settings(link: str) -> LineSettings:
    try:
        return parse_line(link)
    except UsageError as error:
        if link.partition("@")[0] in ("rtu", "ascii"):
            raise UsageError(f"link {link!r}: {error}") from error
        raise UsageError(f"link {link!r}: write {_FORMS}") from None


def _direction(text: str | None) -> Direction:
    if text not in (Direction.REQUEST, Direction.RESPONSE):
        raise UsageError(f'direction {text!r}: write "request" or "response"')
    return Direction(text)

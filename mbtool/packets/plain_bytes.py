"""Bytes of a connection that came in order and were read elsewhere, without a `Stream`."""

from __future__ import annotations

from typing import NamedTuple


class PlainBytes(NamedTuple):
    """Bytes of one direction: whole segments, in order, without a gap or a copy."""

    size: int
    tail: bytes
    """The last bytes: stream.RECENT_BYTES of them, or all if there are fewer."""
    last_segment: int
    """The number of the segment that brought the last byte, counted from 1 over both directions."""
    last_ns: int
    """The time of the segment that brought the last byte, in UTC ns."""


class RestPlace(NamedTuple):
    """The numbers of the next bytes of a connection that waits for nothing and holds nothing."""

    request_sequence: int
    """The sequence number of the next byte of a request."""
    response_sequence: int
    request_position: int
    """The position of the next byte of a request in its direction, as in a StreamPlace."""
    response_position: int

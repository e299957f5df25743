"""Describes bytes that columns/ has decoded from arrays, so that a TcpConnection can move past
them.
"""

from __future__ import annotations

from typing import NamedTuple


class PlainBytes(NamedTuple):
    """Bytes of one direction that were decoded from arrays: whole segments in order, none missing
    or sent twice.
    """

    size: int
    tail: bytes
    """The last stream.RECENT_BYTES bytes, or all if fewer, to compare retransmissions with."""
    last_segment: int
    """The number of segments of both directions together, up to and including the one with the last
    byte."""
    last_ns: int
    """The time of the segment that brought the last byte, in UTC ns."""


class RestPlace(NamedTuple):
    """Where both directions continue in a connection in which no byte waits for another.

    A position counts bytes from the beginning of a direction; it does not wrap.
    """

    request_sequence: int
    """The sequence number of the next request byte."""
    response_sequence: int
    request_position: int
    """The position of the next request byte."""
    response_position: int

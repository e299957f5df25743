"""Describes bytes that the array decoder has read, so that a TcpConnection can move past them."""

from __future__ import annotations

from typing import NamedTuple


class PlainBytes(NamedTuple):
    """Bytes of one direction of a plain stretch, which the array decoder has read.

    They are whole segments in order; none is missing or sent twice. `size` is their number.
    """

    size: int
    tail: bytes
    """The last RECENT_BYTES (stream.py) of these bytes, or all if there are fewer. Retransmissions
    are compared with them."""
    last_segment: int
    """The number of the segment with this direction's last byte. The segments of both directions of
    the plain stretch are counted together, from 1."""
    last_ns: int
    """The time of the segment that brought the last byte, in UTC ns."""


class RestPlace(NamedTuple):
    """The next byte of both directions of a connection in which no byte waits for an earlier one.

    A position is a byte offset from the beginning of the direction; unlike a sequence number it
    does not wrap.
    """

    request_sequence: int
    """The sequence number of the next request byte."""
    response_sequence: int
    request_position: int
    """The byte offset of the next request byte among all request bytes."""
    response_position: int

"""Which bytes of a TCP connection were captured, and which its ends had that the capture lacks."""

# Each segment acknowledges what its sender has received. If that is more than the capture has of
# the other direction, the capture lacks bytes that were on the network. A gap that the reassembler
# reports later for the same bytes is then no further loss.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction

if TYPE_CHECKING:
    from mbtool.core import StreamPlace

OTHER = {Direction.REQUEST: Direction.RESPONSE, Direction.RESPONSE: Direction.REQUEST}


class AduPlace(NamedTuple):
    """Where an ADU stands in its TCP connection. Positions count bytes."""

    end: int
    """The position behind its last byte, in its direction."""
    acknowledged: int | None
    """The position in the other direction that its sender had received; None if unknown."""


class StreamProgress:
    """The position that the captured bytes of each direction have reached."""

    def __init__(self) -> None:
        self._reached: dict[Direction, int] = {}
        self._explained = dict.fromkeys(OTHER, 0)
        """Bytes known to be lost, for which no gap was reported yet."""

    def take(self, direction: Direction, other: Direction, place: StreamPlace, size: int) -> int:
        """Note a segment. Gives how many bytes of the other direction the capture lacks by it."""
        self._reached[direction] = place.position + size
        received = place.acknowledged
        if received is None:
            return 0
        lost = received - self._reached.setdefault(other, received)
        if lost <= 0:
            return 0
        self._reached[other] = received
        self._explained[other] += lost
        return lost

    def skip(self, direction: Direction, missing: int) -> int:
        """Note a reported gap. Gives how many of its bytes were not known to be lost before."""
        explained = min(missing, self._explained[direction])
        self._explained[direction] -= explained
        return missing - explained

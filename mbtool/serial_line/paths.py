"""Rows of pieces that explain a window of an RTU line, and how sure each piece is."""

# A row is a chain: each knows its last piece and the row that it continues, so that rows share what
# they have in common. Of rows that lead to the same turn the cheapest goes on; those that were
# nearly as cheap stay with it as rivals, and raise doubts about the pieces that they have not.

from __future__ import annotations

from enum import Enum
from itertools import groupby, takewhile
from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.serial_line.bus_state import DOUBT, BusState, likelihood

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


class SegmentKind(Enum):
    """What a piece is."""

    FRAME = "frame"
    DAMAGED = "damaged"
    SKIPPED = "skipped"
    OPEN = "open"


class Segment(msgspec.Struct, frozen=True, gc=False):
    """A part of the window."""

    kind: SegmentKind
    place: int
    size: int
    role: Direction = Direction.UNKNOWN
    roles: tuple[Direction, ...] = ()
    """Those whose form a frame has."""
    mended: bytes = b""
    """A damaged frame as it was sent, where one wrong bit explains it."""
    confidence: float = 1.0
    """How sure it is that no other row of pieces explains these bytes."""

    @property
    def form(self) -> tuple[SegmentKind, int, int, Direction]:
        """What it is, however sure that is."""
        return self.kind, self.place, self.size, self.role


class Path(msgspec.Struct, eq=False):
    """Pieces from the first byte to a place, the last of them first."""

    cost: float
    turn: BusState
    before: Path | None
    piece: Segment | None
    skipped: int = 0
    """How many bytes were skipped up to here."""
    is_noise: bool = False
    """Whether these stand right behind a frame, and are all such as a line makes that turns."""
    runs: int = 0
    """How often bytes were skipped before: each time makes the next likelier."""
    is_anchored: bool = False
    """Whether a frame ends here, so that another is likely to begin."""
    rivals: tuple[Path, ...] = ()
    """Rows that lead to the same turn and are nearly as cheap."""


def with_doubts(ends: list[Path]) -> Iterator[Segment]:
    """The pieces of the cheapest row; those that a row nearly as cheap has not are less sure."""
    best = list(_back(ends[0]))
    doubts: dict[int, float] = {}
    for row in best:
        for rival in row.rivals if row is not ends[0] else (*row.rivals, *ends[1:]):
            more = rival.cost - row.cost
            if more < DOUBT:
                for place in _differences(best, row, rival):
                    doubts[place] = min(doubts.get(place, 1.0), likelihood(more))
    for row in reversed(best):
        piece = row.piece
        if piece is not None:
            doubt = doubts.get(piece.place) if piece.kind is SegmentKind.FRAME else None
            yield piece if doubt is None else replace(piece, confidence=doubt)


def doubted(piece: Segment) -> Segment:
    """The same, as likely as not."""
    return replace(piece, confidence=min(piece.confidence, 0.5))


def _back(end: Path) -> Iterator[Path]:
    """A row and those it continues, down to the empty one."""
    row: Path | None = end
    while row is not None:
        yield row
        row = row.before


def agreed_on(ends: list[Path], open_row: Path, end: int) -> list[Segment]:
    """The first pieces, as far as they are right also if more is to come; the rest is open.

    How sure they are is what the open row says, which is cheaper than those without it.
    """
    laid = {row.piece.form for row in _back(ends[0]) if row.piece} if ends else set()
    pieces = with_doubts([open_row, *ends])
    agreed = list(takewhile(lambda piece: piece.form in laid, pieces))
    while agreed and agreed[-1].kind is SegmentKind.SKIPPED:
        agreed.pop()  # There may be more of them.
    place = agreed[-1].place + agreed[-1].size if agreed else 0
    return [*agreed, Segment(SegmentKind.OPEN, place, end - place)]


def _differences(best: list[Path], row: Path, rival: Path) -> list[int]:
    """Where pieces begin that lead to a row and that its rival has not."""
    known = {id(one) for one in best}
    others = set()
    for other in _back(rival):
        if id(other) in known:
            common = other
            break
        others.add(other.piece)
    differing = takewhile(lambda one: one is not common, _back(row))
    return [one.piece.place for one in differing if one.piece and one.piece not in others]


def merged(pieces: Iterable[Segment]) -> Iterator[Segment]:
    """Join skipped bytes that stand side by side."""
    for kind, group in groupby(pieces, key=lambda piece: piece.kind):
        if kind is SegmentKind.SKIPPED:
            first = next(group)
            yield Segment(kind, first.place, first.size + sum(piece.size for piece in group))
        else:
            yield from group

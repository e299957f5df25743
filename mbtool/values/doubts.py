"""Finds values whose type stays in doubt, however well the words of the registers fit it.

The likelihoods of a division compare types that give different numbers. Some types cannot be
distinguished: a register that never changes may be anything, and one that changes next to a
register that is always 0 may be the low word of a longer number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.values.segmentation import Kind

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from mbtool.values.segmentation import Candidate
    from mbtool.values.word_readings import Order

IN_DOUBT = 0.9
"""The likelihood of a type in doubt is at most this."""
_EVIDENT = 2
"""So many numbers of two registers that are beyond doubt vouch for others of their order."""
_LARGE_SPREAD = 4096
_SMALL = 256
_FILLING = (0, 0xFFFF)


def doubtful(
    parts: Sequence[tuple[Candidate, Order]],
    columns: Sequence[Sequence[int]],
    edges: Collection[int],
) -> list[bool]:
    """For each value of a range, in order: True if the words cannot settle what it is.

    `parts` has each value with its order of words, and `columns` the words of each register over
    time. `edges` are the places in the range at which some request begins or ends.
    """
    evident = [
        (candidate.at % 2, order)
        for candidate, order in parts
        if candidate.kind is Kind.INT2 and _is_evident(candidate, order, columns)
    ]
    found = []
    for place, (candidate, order) in enumerate(parts):
        beside = [
            other
            for other, edge in (
                (parts[place - 1] if place else None, candidate.at),
                (
                    parts[place + 1] if place + 1 < len(parts) else None,
                    candidate.at + candidate.words,
                ),
            )
            if other is not None and edge not in edges
        ]
        fillings = [
            columns[other.at][0]
            for other, _ in beside
            if all(map(_is_constant, columns[other.at : other.at + other.words]))
            and (other.kind is Kind.WORD or columns[other.at][0] in _FILLING)
        ]
        if candidate.kind is Kind.WORD:
            found.append(_is_doubtful_word(columns[candidate.at], fillings))
        elif candidate.kind is Kind.INT2:
            vouched = evident.count((candidate.at % 2, order)) >= _EVIDENT
            is_evident = _is_evident(candidate, order, columns)
            moves = not all(map(_is_constant, columns[candidate.at : candidate.at + 2]))
            is_settled = moves and (is_evident or vouched)
            found.append(not is_settled or any(one in _FILLING for one in fillings))
        else:
            found.append(False)
    return found


def _is_doubtful_word(column: Sequence[int], beside: Sequence[int]) -> bool:
    if _is_constant(column):
        return True
    is_wide = max(column) - min(column) >= _LARGE_SPREAD
    return any(one in _FILLING or (is_wide and one < _SMALL) for one in beside)


def _is_evident(candidate: Candidate, order: Order, columns: Sequence[Sequence[int]]) -> bool:
    """True if the upper register of a number moves with the lower one, or is its sign."""
    lower, upper = columns[candidate.at : candidate.at + 2][:: 1 if order.is_low_first else -1]
    return not _is_constant(upper) or (upper[0] == 0xFFFF and not _is_constant(lower))


def _is_constant(column: Sequence[int]) -> bool:
    return all(word == column[0] for word in column)

"""Decides if live tables show links and masters in columns: where there are several of them."""

# On a narrow screen, addresses of one IPv4 /24 network are shown by their last number, as in the
# table of `decode`.

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

from mbtool.views.place_columns import common_network

NARROW = 110
"""On a screen with fewer columns than this, addresses are shown by their last number."""
_WIDEST = 15


class PlaceColumn(NamedTuple):
    """The width and the prefix of the column of links or masters in a live table."""

    width: int
    """The width of the column in characters."""
    prefix: str
    """The part that all texts of the column begin with; it is left out of the cells."""


def place_columns(
    links: Collection[str], masters: Collection[str], width: int
) -> Mapping[str, PlaceColumn]:
    """Return the columns `link` and `master`, each only if there are several links or masters.

    `width` is that of the screen, in characters.
    """
    found = {}
    for name, texts in (("link", links), ("master", masters)):
        if len(texts) > 1:
            network = common_network(texts) if width < NARROW else None
            prefix = network or ""
            longest = max(len(text) - len(prefix) for text in texts)
            found[name] = PlaceColumn(min(max(longest, len(name)), _WIDEST), prefix)
    return found

"""Shows in live tables whose row it is, where several slaves' hosts or masters speak."""

# On a narrow screen, addresses of one IPv4 network with 256 addresses are shown by their last
# number, as in the table of `decode`.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.views.place_columns import common_network

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

NARROW = 110
"""On a screen of fewer columns addresses are shown by their last number."""
_WIDEST = 15


class PlaceColumn(NamedTuple):
    """How the column of links or masters is shown."""

    width: int
    """In characters."""
    prefix: str
    """What all texts of the column begin with, and what is left out of them."""


def place_columns(
    links: Collection[str], masters: Collection[str], width: int
) -> Mapping[str, PlaceColumn]:
    """The columns `link` and `master`, each only if there is more than one to tell apart."""
    found = {}
    for name, texts in (("link", links), ("master", masters)):
        if len(texts) > 1:
            network = common_network(texts) if width < NARROW else None
            prefix = network or ""
            longest = max(len(text) - len(prefix) for text in texts)
            found[name] = PlaceColumn(min(max(longest, len(name)), _WIDEST), prefix)
    return found

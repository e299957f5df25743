"""Finds the settings of the lines that were named without any."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import AutoLink
from mbtool.sources.line_guess import guess_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.core import LinkSpec


def settled(links: Sequence[LinkSpec], say: Callable[[str], None]) -> list[LinkSpec]:
    """The links, each with its settings; what was found is said. Raises LinkError."""
    return [_settled(link, say) if isinstance(link, AutoLink) else link for link in links]


def _settled(link: AutoLink, say: Callable[[str], None]) -> LinkSpec:
    say(f"finding the settings of {link.name} by listening")
    found, sentence = guess_line(link)
    say(sentence)
    return found

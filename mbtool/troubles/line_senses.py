"""The senses that find the troubles of a serial line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.troubles.line_damage import LineDamage
from mbtool.troubles.line_late import LateOnLine
from mbtool.troubles.line_sides import HeardSides
from mbtool.troubles.line_strays import StrayBytes

if TYPE_CHECKING:
    from mbtool.devices.checking.capture_context import CaptureContext
    from mbtool.troubles.sense import Sense


def line_senses(context: CaptureContext) -> list[Sense]:
    """Return a sense of each kind; `context` has facts about the present capture."""
    return [LateOnLine(), HeardSides(), LineDamage(), StrayBytes(context.line_of)]

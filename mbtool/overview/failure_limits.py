"""Limits for the words on failures, which `report` and `watch` share."""

from __future__ import annotations

MANY_REFUSING = 4
"""If at least this many units, and half of all, refuse requests, they are told as one trouble."""
THROUGHOUT = 0.1
"""A failure that shows in this first share (0.1 is 10 %) of a unit's time was there from the
beginning."""
ENDED = 0.25
"""A failure that does not show in this last share (0.25 is 25 %) of a unit's time has ended."""

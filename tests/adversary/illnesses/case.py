"""One recording of an illness with its truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MILD, MEDIUM, SEVERE = "mild", "medium", "severe"
SEVERITIES = (MILD, MEDIUM, SEVERE)

ALONE, DEAD, REFUSING, SLOW = "alone", "dead unit", "exceptions", "slow unit"
BESIDES = (ALONE, DEAD, REFUSING, SLOW)

WITH = {ALONE: "", DEAD: "UNIT-SILENT", REFUSING: "UNIT-REFUSES", SLOW: "UNIT-SLOW"}
"""The code of the ordinary trouble beside an illness."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A recording to make, and what is true of it."""

    illness: str
    """The code that should be told; empty for a healthy plant."""
    severity: str
    beside: str
    timing: str
    write: Callable[[Path], Recording]

    def __str__(self) -> str:
        return ", ".join((self.illness or "healthy", self.severity, self.beside, self.timing))


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A file that was made."""

    arguments: list[str]
    """The file, and the options with which to read it."""
    innocent: frozenset[int]
    """Units that did what they should: their slaves answered each request that they understood, in
    time."""
    also: frozenset[str] = frozenset()
    """Codes that are true as well, beside the illness."""

"""Reads the small files of /sys and /proc. A file that cannot be read is taken as empty."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def read_text(path: Path) -> str:
    """Return the whole text of a file; "" if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def read_line(path: Path) -> str:
    """The first line of a file, without white space around it; "" if it cannot be read."""
    return read_text(path).partition("\n")[0].strip()


def read_number(path: Path) -> int | None:
    """The number in the first line of a file, decimal or 0x...; None if there is none."""
    try:
        return int(read_line(path), 0)
    except ValueError:
        return None

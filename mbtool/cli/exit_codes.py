"""The exit codes of every command, as docs/commands.md lists them."""

from __future__ import annotations

DONE = 0
NO = 1
"""The command ran, and its result is negative: it found differences, broken rules or changes."""
USAGE = 2
UNREADABLE = 3
"""An input could not be read or has no usable content, or a link could not be opened."""
INTERRUPTED = 130
"""Ctrl-C or SIGTERM ended the command."""

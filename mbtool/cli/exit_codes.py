"""The exit codes of every command, as docs/commands.md lists them."""

from __future__ import annotations

DONE = 0
NO = 1
"""The result is negative: there are differences, findings, or something new."""
USAGE = 2
UNREADABLE = 3
"""An input could not be read or has no usable content, or a link could not be opened."""
INTERRUPTED = 130
"""Ended by Ctrl-C or SIGTERM."""

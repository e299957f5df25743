"""How the program leaves on a signal where there is nothing to be completed."""

from __future__ import annotations

import os

from mbtool.cli import exit_codes


def leave(*_: object) -> None:
    """End without a word, whatever the interpreter is at: an import, or its own end."""
    os._exit(exit_codes.INTERRUPTED)

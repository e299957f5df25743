"""Reads a TOML file that a user gives to a slave."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

from mbtool.core import InputError

if TYPE_CHECKING:
    from pathlib import Path


def read_toml(path: Path, max_bytes: int, what: str, hint: str) -> dict[str, Any]:
    """The keys of a file, in their order.

    Raises InputError for one that cannot be read, is longer than `max_bytes` and so no `what`, or
    is no TOML; `hint` says what would be.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(max_bytes + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(data) > max_bytes:
        raise InputError(f"{path}: more than {max_bytes} bytes are no {what}")
    try:
        return tomllib.loads(data.decode("utf-8-sig"))  # Some editors begin with such a mark.
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not TOML: {error}; {hint}") from error

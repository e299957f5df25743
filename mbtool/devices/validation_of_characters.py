"""Checks that no text of a profile has control characters."""

# Texts of a profile are printed in tables, in lines of a log and in finding codes. A line end would
# break the table or the line, and a terminal would execute an escape sequence. Only the keys `note`
# and `notes` may have line ends and tabs.

from __future__ import annotations

import unicodedata
from typing import TYPE_CHECKING, Any

import msgspec

from mbtool.core.errors import ProfileError
from mbtool.devices.model import Area, Point

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile

_REFUSED = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""The Unicode categories that texts must not contain: control characters, surrogates, line and
paragraph separators."""
_NOTES = ("notes", "note")
_ALLOWED_IN_NOTES = "\n\r\t"


def validate_characters(profile: Profile, file: str) -> None:
    """Raise ProfileError for the first text of a profile that has a control character; a note may
    have line ends and tabs.

    `file` is the name of the profile's file, for the message.
    """
    for key, text in _texts("", profile):
        allowed = _ALLOWED_IN_NOTES if key.rpartition(".")[2] in _NOTES else ""
        for one in text:
            if unicodedata.category(one) in _REFUSED and one not in allowed:
                raise ProfileError(
                    file, key, f"{text!r} has a control character, {one!r}; leave it out"
                )


def _texts(key: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield each text in `value` that has unprintable characters, with its key.

    `value` is the value of the key `key`: a profile, a part of one, a list, a dictionary or a text.
    """
    if isinstance(value, str):
        if not value.isprintable():
            yield key, value
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from _texts(f"{key}.{name}" if key else name, getattr(value, name))
    elif isinstance(value, dict):
        for name, one in value.items():
            yield from _texts(f"{key}.{name}", one)
    elif isinstance(value, list):
        for one in value:
            named = isinstance(one, Area | Point)
            yield from _texts(f"{key} {_quoted(one.name)}" if named else key, one)


def _quoted(name: str) -> str:
    return f'"{"".join(one if one.isprintable() else "?" for one in name)}"'

"""Reads a user's TOML file: a profile, start values, or a list of faults."""

# This module is not in core/, because core/ does no I/O. The caller states the largest file size.

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.core.errors import InputError, UsageError, reason_of
from mbtool.core.nesting import why_too_deep

if TYPE_CHECKING:
    from pathlib import Path

_ADVICE = (
    ("Invalid value", "; a value is a number, a text in quotes, true, false, a list or a table"),
    ("Expected newline", "; a line has one key and its value"),
    ("Cannot overwrite a value", "; the key of this line stands further up already"),
    ("Cannot declare", "; a table is begun once, and [[...]] adds one to a list"),
    ("Illegal character", "; a text ends in the line where it begins: is a quote missing?"),
    ("Invalid statement", "; write key = value, or [table]"),
    ("Expected '=' after a key", "; write key = value, and quotes around a key with spaces"),
)
"""Pairs of two texts: the beginning of an error message of the TOML parser, and advice for the user
to append to the message."""


class TomlError(UsageError):
    """Raised for a file that is not TOML."""

    def __init__(self, file: str, place: str, problem: str) -> None:
        super().__init__(f"{file}: {place}: {problem}")
        self.place = place
        """The place of the mistake: a line, byte or key of the file, or a word such as `size`."""
        self.problem = problem


def read_toml(path: Path, max_bytes: int, what: str, hint: str = "") -> dict[str, Any]:
    """Read the keys and values of a TOML file, in the order of the file.

    Raises InputError if the file cannot be read, TomlError if it is longer than `max_bytes`, nests
    too deep, or is not TOML. `what` names the kind of file in messages, such as `profile`; `hint`
    is appended to the parser's message about a line.
    """
    file = str(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(max_bytes + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {reason_of(error)}") from error
    return parse_toml(data, file, max_bytes, what, hint)


def parse_toml(data: bytes, file: str, max_bytes: int, what: str, hint: str = "") -> dict[str, Any]:
    """Read the keys and values of the content of a TOML file, as read_toml() does.

    Raises TomlError, which names the file `file`.
    """
    import tomllib  # Imported here: most commands read no such file.

    if len(data) > max_bytes:
        raise TomlError(file, "size", f"more than {max_bytes} bytes are no {what}")
    try:
        text = data.decode("utf-8-sig")  # Some editors write a byte order mark.
        if too_deep := why_too_deep(text):
            raise TomlError(file, "TOML", too_deep)
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        problem = "not UTF-8, so not TOML; save it as UTF-8"
        raise TomlError(file, f"byte {error.start}", problem) from error
    except ValueError as error:
        problem, at, place = str(error).rpartition(" (at ")
        problem = problem if at else str(error)
        advice = next((words for known, words in _ADVICE if problem.startswith(known)), "")
        raise TomlError(
            file,
            place.rstrip(")") if at else "TOML",
            f"not TOML: {problem}{advice}{hint and f'; {hint}'}",
        ) from error
